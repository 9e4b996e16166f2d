// Prints the global positions of all bones and nodes of a glTF file at the times given, as three.js animates it.
// Usage: node read_gltf.mjs THREE_FOLDER FILE.glb CLIP TIME…
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [folder, file, clip, ...times] = process.argv.slice(2);
const load = (path) => import(pathToFileURL(`${folder}/${path}`).href);
globalThis.self = globalThis;
const THREE = await load("build/three.module.js");
const { GLTFLoader } = await load("examples/jsm/loaders/GLTFLoader.js");

const bytes = readFileSync(file);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const gltf = await new GLTFLoader().parseAsync(buffer, "");
const mixer = new THREE.AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[Number(clip)]);
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const found = {};
for (const time of times) {
  mixer.setTime(Number(time));
  gltf.scene.updateMatrixWorld(true);
  gltf.scene.traverse((node) => {
    const place = new THREE.Vector3().setFromMatrixPosition(node.matrixWorld);
    (found[node.userData.name ?? node.name] ??= []).push(place.toArray());
  });
}
console.log(JSON.stringify(found));
