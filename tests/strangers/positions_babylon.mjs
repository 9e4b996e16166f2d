// Prints the world positions of all nodes of a glTF file at the times given, as Babylon.js animates it.
// Usage: node positions_babylon.mjs FILE.glb TIME…
import { readFileSync } from "node:fs";
import { FreeCamera } from "@babylonjs/core/Cameras/freeCamera.js";
import { NullEngine } from "@babylonjs/core/Engines/nullEngine.js";
import { ImportMeshAsync } from "@babylonjs/core/Loading/sceneLoader.js";
import { Logger } from "@babylonjs/core/Misc/logger.js";
import { Vector3 } from "@babylonjs/core/Maths/math.vector.js";
import { Scene } from "@babylonjs/core/scene.js";
import "@babylonjs/loaders/glTF/2.0/index.js";

Logger.LogLevels = Logger.ErrorLogLevel; // stdout is for the result
const [file, ...times] = process.argv.slice(2);
const scene = new Scene(new NullEngine());
scene.useRightHandedSystem = true;
new FreeCamera("camera", Vector3.Zero(), scene);
await ImportMeshAsync(new Uint8Array(readFileSync(file)), scene, { pluginExtension: ".glb" });
const [group] = scene.animationGroups;
const rate = group.targetedAnimations[0].animation.framePerSecond;
group.start(false);
group.pause(); // so that the clock does not move it on
const positions = {};
for (const time of times) {
  group.goToFrame(Math.min(Number(time) * rate, group.to));
  for (const node of scene.transformNodes) {
    node.computeWorldMatrix(true);
    (positions[node.name] ??= []).push(node.getAbsolutePosition().asArray());
  }
}
console.log(JSON.stringify({ positions }));
process.exit(0);
