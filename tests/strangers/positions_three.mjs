// Prints the world positions of all nodes of a glTF file at the times given, as three.js animates it.
// Usage: node positions_three.mjs FILE.glb TIME…
import { readFileSync } from "node:fs";
import * as THREE from "three";

globalThis.self = globalThis;
const { GLTFLoader } = await import("three/examples/jsm/loaders/GLTFLoader.js");

const [file, ...times] = process.argv.slice(2);
const bytes = readFileSync(file);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const gltf = await new GLTFLoader().parseAsync(buffer, "");
const mixer = new THREE.AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[0]);
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const positions = {};
const vertices = []; // of the body, skinned, at the last time
for (const time of times) {
  action.paused = false; // it pauses where it ends
  mixer.setTime(Number(time));
  gltf.scene.updateMatrixWorld(true);
  gltf.scene.traverse((node) => {
    const place = new THREE.Vector3().setFromMatrixPosition(node.matrixWorld);
    (positions[node.userData.name ?? node.name] ??= []).push(place.toArray());
  });
}
gltf.scene.traverse((node) => {
  if (!node.isSkinnedMesh) return;
  node.skeleton.update();
  for (let k = 0; k < node.geometry.attributes.position.count; k++)
    vertices.push(node.localToWorld(node.getVertexPosition(k, new THREE.Vector3())).toArray());
});
console.log(JSON.stringify({ positions, vertices }));
