import { type Material, MeshStandardMaterial } from "three";

/** More opaque at grazing angles, which emphasises the silhouette. */
const OUTLINED = `
diffuseColor.a *= 0.22 + 0.78 * pow(1.0 - abs(dot(normalize(vViewPosition), normal)), 1.6);
#include <opaque_fragment>`;

/**
 * Materials of both figures. The comparison is translucent and shows only its outer surface.
 *
 * Its depth is offset by a few millimetres, so that it is visible only where the figures differ.
 */
export function materials() {
  const main = new MeshStandardMaterial({ vertexColors: true, roughness: 0.62, metalness: 0 });
  const behind = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 250 };
  const prepass = new MeshStandardMaterial({ ...behind, vertexColors: true, colorWrite: false });
  const other = new MeshStandardMaterial({ ...behind, roughness: 0.7, transparent: true, depthWrite: false });
  other.onBeforeCompile = (shader) => {
    shader.fragmentShader = shader.fragmentShader.replace("#include <opaque_fragment>", OUTLINED);
  };
  return { main, prepass, other } satisfies Record<string, Material>;
}
