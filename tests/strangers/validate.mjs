// Prints the report of Khronos' glTF validator for each file as one JSON list. Usage: node validate.mjs FILE.glb…
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

const reports = [];
for (const file of process.argv.slice(2)) {
  reports.push(await validator.validateBytes(new Uint8Array(readFileSync(file)), { maxIssues: 100 }));
}
console.log(JSON.stringify(reports));
