/** Reads a GLB or VRM file; the loader is fetched when the first file is dropped. */

import type { Object3D } from "three";
import { Model } from "./model";

export const FIGURE_FILE = /\.(glb|vrm)$/i;
const MOST_BYTES = 128 * 1024 * 1024;

type Table = Record<string, unknown>;

export async function loadModel(file: Blob): Promise<Model> {
  if (file.size > MOST_BYTES) throw new Error(`A figure may have ${MOST_BYTES / 2 ** 20} MB at most.`);
  const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
  const content = await file.arrayBuffer();
  const gltf = await new GLTFLoader().parseAsync(content, "").catch((err: unknown) => {
    throw new Error(`This file cannot be read: ${err instanceof Error ? err.message : String(err)}`);
  });
  const bones = humanBones((gltf.parser.json as Table).extensions);
  const rows = Object.entries(bones).map(async ([bone, node]) => {
    const object: Object3D = await gltf.parser.getDependency("node", node);
    return [bone, object] as const;
  });
  return new Model(gltf.scene, Object.fromEntries(await Promise.all(rows)));
}

/** Node of each bone that a VRM file names, of both versions of the format. */
function humanBones(extensions: unknown): Record<string, number> {
  const { VRMC_vrm, VRM } = (extensions ?? {}) as { VRMC_vrm?: Table; VRM?: Table };
  const rows = (table?: Table) => ((table?.humanoid as Table | undefined)?.humanBones ?? {}) as object;
  const found: Record<string, number> = {};
  for (const [bone, row] of Object.entries(rows(VRMC_vrm))) found[bone] = (row as { node: number }).node;
  const old = Object.values(rows(VRM)) as { bone: string; node: number }[];
  for (const { bone, node } of old)
    found[bone.replace("ThumbProximal", "ThumbMetacarpal").replace("ThumbIntermediate", "ThumbProximal")] = node;
  return found;
}
