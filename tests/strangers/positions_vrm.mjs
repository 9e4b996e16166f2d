// Prints the positions of the humanoid bones of a VRM that plays a VRM animation, as three-vrm poses it.
// Usage: node positions_vrm.mjs AVATAR.vrm MOTION.vrma TIME…
import { readFileSync } from "node:fs";
import { VRMLoaderPlugin } from "@pixiv/three-vrm";
import { createVRMAnimationClip, VRMAnimationLoaderPlugin } from "@pixiv/three-vrm-animation";
import * as THREE from "three";

globalThis.self = globalThis;
const { GLTFLoader } = await import("three/examples/jsm/loaders/GLTFLoader.js");

async function load(file) {
  const loader = new GLTFLoader();
  loader.register((parser) => new VRMLoaderPlugin(parser));
  loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
  const bytes = readFileSync(file);
  return loader.parseAsync(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength), "");
}

const [avatar, motion, ...times] = process.argv.slice(2);
const { vrm } = (await load(avatar)).userData;
const [animation] = (await load(motion)).userData.vrmAnimations;
const mixer = new THREE.AnimationMixer(vrm.scene);
const action = mixer.clipAction(createVRMAnimationClip(animation, vrm));
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const positions = {};
for (const time of times) {
  action.paused = false; // it pauses where it ends
  mixer.setTime(Number(time));
  vrm.humanoid.update();
  vrm.scene.updateMatrixWorld(true);
  for (const bone of Object.keys(vrm.humanoid.humanBones)) {
    const node = vrm.humanoid.getRawBoneNode(bone);
    (positions[bone] ??= []).push(node.getWorldPosition(new THREE.Vector3()).toArray());
  }
}
console.log(JSON.stringify({ positions }));
