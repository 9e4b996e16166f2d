/** Bones of a humanoid by the names of joints; the tables and the rules are those of verbs/mapping/names.py. */

import {
  ALIASES,
  DROPPED,
  EXCLUDED,
  FINGER,
  FINGER_NAMES,
  FINGER_PARTS,
  HEAD,
  HIPS,
  LEFT,
  PREFIX,
  RIGHT,
  SEPARATORS,
  SIDE_LETTER,
  UNSURE,
} from "../generated/mapping_table.js";

/** The humanoid of a skeleton: joints of VRM bones, and those of the spine and the neck from below. */
export interface Roles {
  bones: Record<string, number>;
  spine: number[];
  neck: number[];
}

const prefix = new RegExp(PREFIX);
const separators = new RegExp(SEPARATORS);
const sideLetter = new RegExp(SIDE_LETTER, "g");
const finger = new RegExp(FINGER);

/** Side (`left`, `right` or empty) and plain name of a joint; an empty name for joints that are no bones. */
export function label(name: string): [side: string, plain: string] {
  let rest = (name.split(/[:|/]/).at(-1) ?? "").trim();
  for (;;) {
    const short = rest.slice(prefix.exec(rest.toLowerCase())?.[0].length ?? rest.length);
    if (!short || short === rest || /^\p{Ll}/u.test(short)) break;
    rest = short.replace(separators, "");
  }
  let words = (rest.replace(sideLetter, "$1$2_").match(/[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+/g) ?? []).map((word) =>
    word.toLowerCase(),
  );
  words = words.map((word) => (/^\d/.test(word) ? String(Number(word)) : word));
  if (words.some((word) => EXCLUDED.includes(word))) return ["", ""];
  let side = "";
  const at = words.findIndex((word) => LEFT.includes(word) || RIGHT.includes(word));
  if (at >= 0) side = LEFT.includes(words.splice(at, 1)[0] as string) ? "left" : "right";
  const kept = words.filter((word) => !DROPPED.includes(word));
  const plain = (kept.length > 0 ? kept : words).join("");
  return side ? [side, plain] : joinedSide(plain);
}

function joinedSide(plain: string): [string, string] {
  const known = Object.values(ALIASES).flat();
  for (const [side, words] of [
    ["left", LEFT],
    ["right", RIGHT],
  ] as const)
    for (const word of words) {
      const start = plain.startsWith(word) ? plain.slice(word.length) : plain;
      const end = plain.endsWith(word) ? plain.slice(0, plain.length - word.length) : plain;
      for (const rest of [start, end])
        if (rest !== plain && (known.includes(rest) || (word.length > 1 && finger.test(rest)))) return [side, rest];
    }
  return ["", plain];
}

/** @param given joints of VRM bones that the file itself names */
export function rolesOf(
  names: readonly string[],
  parents: readonly number[],
  given: Readonly<Record<string, number>> = {},
): Roles {
  const labels = names.map(label);
  const depths: number[] = [];
  for (const parent of parents) depths.push(parent >= 0 ? (depths[parent] as number) + 1 : 0);
  const depth = (joint: number) => depths[joint] as number;
  const bones: Record<string, number> = {};
  for (const side of ["left", "right"]) {
    const own = new Map(labels.flatMap(([each, plain], joint) => (each === side ? [[joint, plain] as const] : [])));
    Object.assign(bones, limbs(side, own, depth, parents), fingers(side, own, depth));
  }
  const plain = (list: readonly string[]) =>
    labels.flatMap(([side, word], joint) => (!side && list.includes(word) ? [joint] : []));
  const [head] = plain(HEAD).sort((a, b) => depth(a) - depth(b) || a - b);
  if (head !== undefined) bones.head = head;
  const trunk = ["spine", "chest", "upperChest", "neck"];
  const stated = Object.fromEntries(Object.entries(given).filter(([bone]) => !trunk.includes(bone)));
  for (const [bone, joint] of Object.entries(bones)) if (Object.values(stated).includes(joint)) delete bones[bone];
  Object.assign(bones, stated);
  const present = (list: string[]) => list.flatMap((bone) => bones[bone] ?? []);
  const legs = present(["leftUpperLeg", "rightUpperLeg"]);
  const arms = present(["leftUpperArm", "rightUpperArm", "head"]);
  if (bones.hips === undefined) {
    const rank = (joint: number) => HIPS.indexOf(labels[joint]?.[1] ?? "");
    const [named] = plain(HIPS).sort((a, b) => rank(a) - rank(b) || depth(a) - depth(b));
    if (legs.length === 2) bones.hips = common(parents, [...legs, ...arms.slice(0, 1)]);
    else if (named !== undefined) bones.hips = named;
  }
  if (bones.hips === undefined || arms.length < 2) return { bones, spine: [], neck: [] };
  const chest = common(parents, arms);
  const spine = between(parents, bones.hips, chest);
  const neck = bones.head === undefined ? [] : between(parents, chest, bones.head).slice(0, -1);
  return { bones, spine, neck };
}

type Own = ReadonlyMap<number, string>;
type Depth = (joint: number) => number;

function limbs(side: string, own: Own, depth: Depth, parents: readonly number[]): Record<string, number> {
  const words = [...own.values()];
  const sure = new Set(
    Object.entries(ALIASES).flatMap(([bone, aliases]) =>
      words.some((word) => aliases.includes(word) && !UNSURE.includes(word)) ? [bone] : [],
    ),
  );
  const found: Record<string, number> = {};
  for (const [bone, aliases] of Object.entries(ALIASES)) {
    const rows = [...own]
      .filter(([, word]) => aliases.includes(word) && standsFor(word, bone, sure, words))
      .map(([joint, word]) => [aliases.indexOf(word), depth(joint), joint] as const)
      .sort((a, b) => a[0] - b[0] || a[1] - b[1] || a[2] - b[2]);
    if (rows[0]) found[bone] = rows[0][2];
  }
  for (const [above, below] of [
    ["LowerArm", "Hand"],
    ["LowerLeg", "Foot"],
    ["UpperArm", "LowerArm"],
    ["UpperLeg", "LowerLeg"],
  ] as const) {
    const parent = parents[found[below] ?? -1] ?? -1;
    if (found[above] === undefined && parent >= 0 && !Object.values(found).includes(parent)) found[above] = parent;
  }
  return Object.fromEntries(Object.entries(found).map(([bone, joint]) => [side + bone, joint]));
}

function standsFor(word: string, bone: string, sure: ReadonlySet<string>, words: readonly string[]): boolean {
  if (word === "shoulder") return bone === (sure.has("UpperArm") ? "Shoulder" : "UpperArm");
  if (word === "hip") return bone === "UpperLeg" && !sure.has("UpperLeg") && !words.includes("leg");
  if (word === "leg") return bone === (!sure.has("UpperLeg") && sure.has("LowerLeg") ? "UpperLeg" : "LowerLeg");
  if (word === "foot") return bone === (words.includes("ankle") ? "Toes" : "Foot");
  return true;
}

function fingers(side: string, own: Own, depth: Depth): Record<string, number> {
  const rows: Record<string, number[]> = {};
  for (const [joint, word] of [...own].sort(([a], [b]) => depth(a) - depth(b) || a - b)) {
    const match = finger.exec(word);
    const name = FINGER_NAMES[match?.[1] ?? ""];
    if (!match || !name || (name !== "Thumb" && match[2]?.includes("metacarpal"))) continue;
    rows[name] = [...(rows[name] ?? []), joint];
  }
  return Object.fromEntries(
    Object.entries(rows).flatMap(([name, joints]) =>
      (FINGER_PARTS[name] ?? FINGER_PARTS[""] ?? []).flatMap((part, k) => {
        const joint = joints[k];
        return joint === undefined ? [] : [[side + name + part, joint]];
      }),
    ),
  );
}

/** A joint and all above it, the joint first. */
function chain(parents: readonly number[], joint: number): number[] {
  const found: number[] = [];
  for (let each = joint; each >= 0; each = parents[each] ?? -1) found.push(each);
  return found;
}

function common(parents: readonly number[], joints: readonly number[]): number {
  const chains = joints.map((joint) => chain(parents, joint));
  return chains[0]?.find((joint) => chains.every((each) => each.includes(joint))) ?? 0;
}

function between(parents: readonly number[], above: number, joint: number): number[] {
  const found = chain(parents, joint);
  const at = found.indexOf(above);
  return at < 0 ? [] : found.slice(0, at).reverse();
}
