import { BufferAttribute, type BufferGeometry } from "three";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";
import type { Skeleton } from "../types";
import { anatomyOf, isChain, isHuman } from "./anatomy";
import { human } from "./body";
import { armParts, creatureParts } from "./creature";
import type { Part } from "./parts";
import { type Detail, shapeOf } from "./shapes";

/** Brightness of the two tones, relative to the figure's colour. */
const TONES = { body: 1, joint: 0.34 } as const;

/** Parts of a mannequin for a skeleton. */
export function planOf(skeleton: Skeleton): readonly Part[] {
  const anatomy = anatomyOf(skeleton);
  if (isHuman(anatomy)) return human(anatomy);
  return isChain(anatomy) ? armParts(anatomy) : creatureParts(anatomy);
}

/** One geometry per joint in the joint's frame, with tones as vertex colours. */
export function mannequin(skeleton: Skeleton, detail: Detail): Map<number, BufferGeometry> {
  const pieces = new Map<number, BufferGeometry[]>();
  for (const part of planOf(skeleton)) {
    if (part.fine && detail !== "high") continue;
    if (part.form === "ball" && detail === "simple") continue;
    const shape = shapeOf(part, detail);
    const tone = new Float32Array(3 * shape.getAttribute("position").count).fill(TONES[part.tone]);
    shape.setAttribute("color", new BufferAttribute(tone, 3));
    pieces.set(part.joint, [...(pieces.get(part.joint) ?? []), shape]);
  }
  const whole = new Map<number, BufferGeometry>();
  for (const [joint, shapes] of pieces) {
    whole.set(joint, mergeGeometries(shapes));
    for (const shape of shapes) shape.dispose();
  }
  return whole;
}
