import { type Material, MeshStandardMaterial } from "three";

/** More solid where the surface turns away from the eye: outlines say more than what lies inside them. */
const OUTLINED = `
diffuseColor.a *= 0.22 + 0.78 * pow(1.0 - abs(dot(normalize(vViewPosition), normal)), 1.6);
#include <opaque_fragment>`;

/**
 * Materials of both sides: what is set against the main side shows through, each figure only its outside.
 *
 * It is held a few millimetres behind where it is, so that it shows only where both sides differ.
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
