import { type Anatomy, ends, type Region } from "./anatomy";
import type { Part, Station, Tone } from "./parts";
import { add, dot, length, lerp, mean, scale, square, sub, unit, type V3, ZERO } from "./vec";

/** Leg length (thigh and shin) of the reference body, m. */
const LEG_M = 0.86;

/** Cross-section of a limb: position 0–1, half-width, half-depth, forward offset. */
type Ring = readonly [number, number, number, number?];

/** Limb shapes and joint balls for a leg length of `LEG_M`. */
const LIMBS: Partial<Record<Region, { rings: readonly Ring[]; ball: number; cap?: Tone }>> = {
  upperArm: {
    ball: 0.048,
    cap: "body",
    rings: [
      [0.05, 0.04, 0.042],
      [0.35, 0.042, 0.047],
      [0.75, 0.035, 0.038],
      [0.92, 0.032, 0.034],
    ],
  },
  forearm: {
    ball: 0.036,
    rings: [
      [0.09, 0.035, 0.034],
      [0.3, 0.039, 0.038],
      [0.7, 0.028, 0.029],
      [0.92, 0.021, 0.026],
    ],
  },
  thigh: {
    ball: 0.07,
    rings: [
      [0.03, 0.074, 0.078],
      [0.3, 0.073, 0.078, 0.004],
      [0.7, 0.056, 0.058, 0.006],
      [0.93, 0.047, 0.049],
    ],
  },
  shin: {
    ball: 0.049,
    rings: [
      [0.06, 0.044, 0.045],
      [0.28, 0.05, 0.053, -0.01],
      [0.62, 0.038, 0.04, -0.006],
      [0.92, 0.027, 0.031],
    ],
  },
};

/** Dimensions of one body and the frame of its shapes. */
interface Build {
  readonly anatomy: Anatomy;
  /** Scale relative to `LEG_M`. */
  readonly size: number;
  /** Joint that carries neck and arms, or the root. */
  readonly chest: number;
  readonly hips: number;
  /** Midpoints of the upper arms and of the thighs at rest. */
  readonly shoulders: V3;
  readonly crotch: V3;
  /** Half the distance between the upper arms and between the thighs. */
  readonly shoulder: number;
  readonly hip: number;
}

const jointsOf = (a: Anatomy, region: Region): number[] => a.regions.flatMap((r, j) => (r === region ? [j] : []));
const goalSpaceOf = (a: Anatomy, j: number): V3 => a.positions[j] ?? ZERO;

/** First common ancestor of both upper arms. */
function chestOf(a: Anatomy): number {
  const up = (j: number): number[] => (j < 0 ? [] : [j, ...up(a.parents[j] ?? -1)]);
  const [one, other] = jointsOf(a, "upperArm").map(up) as [number[], number[]];
  return one.find((j) => other.includes(j)) ?? 0;
}

function buildOf(a: Anatomy): Build {
  const pair = (region: Region) => jointsOf(a, region).map((j) => goalSpaceOf(a, j)) as [V3, V3];
  const [arms, thighs] = [pair("upperArm"), pair("thigh")];
  const step = (region: Region) => mean(jointsOf(a, region).map((j) => [length(a.offsets[j] as V3), 0, 0]))[0];
  return {
    anatomy: a,
    size: (step("shin") + step("foot")) / LEG_M,
    chest: chestOf(a),
    hips: a.parents[jointsOf(a, "thigh")[0] as number] as number,
    shoulders: mean(arms),
    crotch: mean(thighs),
    shoulder: length(sub(arms[0], arms[1])) / 2,
    hip: length(sub(thighs[0], thighs[1])) / 2,
  };
}

/** Loft on a joint from rings [up, wide, deep, forward] around a rest position, scaled by the body size. */
function torso(b: Build, joint: number, centre: V3, rings: readonly Ring[], tone: Tone, boxy = 2.3): Part {
  const { anatomy: a, size } = b;
  const from = sub(centre, goalSpaceOf(a, joint));
  const stations = rings.map(([up, wide, deep, front = 0]) => ({
    at: add(from, add(scale(a.up, up * size), scale(a.forward, front * size))),
    wide: wide * size,
    deep: deep * size,
  }));
  return { form: "loft", joint, tone, stations, side: a.left, boxy };
}

/** Pelvis, waist and rib cage: widths from the joints, depths from the body size. */
function trunk(b: Build): Part[] {
  const { anatomy: a, size } = b;
  const [hip, arm] = [b.hip / size, b.shoulder / size];
  const pelvis = torso(
    b,
    b.hips,
    b.crotch,
    [
      [-0.035, 0.72 * hip, 0.066],
      [0, hip + 0.034, 0.086, -0.008],
      [0.05, hip + 0.04, 0.09, -0.01],
      [0.115, hip + 0.016, 0.078],
    ],
    "body",
  );
  const ribs = torso(
    b,
    b.chest,
    b.shoulders,
    [
      [-0.265, 0.098, 0.072, 0.004],
      [-0.2, 0.126, 0.1, 0.012],
      [-0.1, 0.148, 0.112, 0.012],
      [-0.02, Math.min(0.138, arm - 0.03), 0.094],
      [0.035, 0.075, 0.058, -0.012],
    ],
    "body",
  );
  const spine = jointsOf(a, "spine").filter((j) => j !== b.chest);
  const middle = spine[Math.floor(spine.length / 2)] ?? b.hips;
  const low = add(b.crotch, scale(a.up, 0.08 * size));
  const high = add(b.shoulders, scale(a.up, -0.23 * size));
  const rings: readonly Ring[] = [
    [0, 0.1, 0.072],
    [length(sub(high, low)) / size / 2, 0.103, 0.074],
    [length(sub(high, low)) / size, 0.092, 0.07],
  ];
  return [pelvis, ribs, torso(b, middle, low, rings, "joint", 2)];
}

/** Neck and head; the head narrows to a chin, so that its direction is visible. */
function headAndNeck(b: Build): Part[] {
  const { anatomy: a, size } = b;
  const head = jointsOf(a, "head")[0] as number;
  const neck = jointsOf(a, "neck")[0] ?? a.parents[head] ?? head;
  const crown = a.tips[head]?.[0] ?? scale(a.up, 0.175 * size);
  const high = Math.max(length(crown), 0.12 * size);
  const up = unit(crown);
  const base = sub(add(b.shoulders, scale(a.up, 0.02 * size)), goalSpaceOf(a, neck));
  const top = add(sub(goalSpaceOf(a, head), goalSpaceOf(a, neck)), scale(up, 0.03 * size));
  const ring = (at: V3, radius: number): Station => ({ at, wide: radius * size, deep: radius * size });
  const k = high / 0.175;
  const egg = ([rise, wide, deep, front = 0]: Ring): Station => ({
    at: add(scale(up, rise * k), scale(square(a.forward, up), front * k)),
    wide: wide * k,
    deep: deep * k,
  });
  const rings: readonly Ring[] = [
    [-0.03, 0.038, 0.05, 0.042],
    [-0.005, 0.054, 0.075, 0.026],
    [0.04, 0.068, 0.092, 0.012],
    [0.085, 0.075, 0.098, 0.004],
    [0.122, 0.068, 0.09, -0.001],
  ];
  return [
    {
      form: "loft",
      joint: neck,
      tone: "joint",
      side: a.left,
      boxy: 2,
      stations: [ring(base, 0.052), ring(lerp(base, top, 0.5), 0.046), ring(top, 0.046)],
    },
    { form: "loft", joint: head, tone: "body", side: a.left, boxy: 2.1, stations: rings.map(egg) },
  ];
}

/** Limb between two joints with a ball at its start. */
function limb(b: Build, joint: number, region: Region): Part[] {
  const shape = LIMBS[region];
  const end = ends(b.anatomy, joint)[0];
  if (!shape || !end) return [];
  const [axis, { size }] = [unit(end), b];
  const leg = region === "thigh" || region === "shin";
  const front = square(leg ? b.anatomy.forward : b.anatomy.up, axis);
  const side = square(leg ? b.anatomy.left : b.anatomy.forward, axis);
  const stations = shape.rings.map(([t, wide, deep, ahead = 0]) => ({
    at: add(scale(end, t), scale(front, ahead * size)),
    wide: wide * size,
    deep: deep * size,
  }));
  return [
    { form: "ball", joint, tone: shape.cap ?? "joint", at: ZERO, radius: shape.ball * size },
    { form: "loft", joint, tone: "body", stations, side, boxy: 2 },
  ];
}

/** Shoulder segment between rib cage and upper arm. */
function collar(b: Build, joint: number): Part[] {
  const end = ends(b.anatomy, joint)[0];
  if (!end) return [];
  const { size } = b;
  const inward = scale(b.anatomy.left, dot(end, b.anatomy.left) > 0 ? -0.1 * size : 0.1 * size);
  const from = add(end, add(inward, scale(b.anatomy.up, 0.004 * size)));
  const stations = [
    { at: from, wide: 0.06 * size, deep: 0.044 * size },
    { at: lerp(from, end, 0.62), wide: 0.048 * size, deep: 0.042 * size },
  ];
  return [{ form: "loft", joint, tone: "body", stations, side: b.anatomy.forward, boxy: 2 }];
}

/** Lateral position and relative length of each finger. */
const FINGERS = [
  [0.028, 0.9],
  [0.0095, 0.99],
  [-0.009, 0.94],
  [-0.027, 0.82],
] as const;

/** Palm, fingers and thumb, palm down at rest; only the palm if the fingers have joints. */
function hand(b: Build, joint: number): Part[] {
  const { anatomy: a, size } = b;
  const end = ends(a, joint)[0];
  if (!end) return [];
  const [along, jointed] = [unit(end), (a.children[joint] ?? []).length > 0];
  const [front, palm] = [square(a.forward, along), scale(square(a.up, along), -1)];
  const long = jointed ? length(end) * 2 : Math.max(length(end), 0.172 * size);
  const at = (x: number, y: number, z: number): V3 =>
    add(scale(along, x * long), add(scale(front, y * size), scale(palm, z * size)));
  const flat = (x: number, wide: number, deep: number): Station => {
    return { at: at(x, 0, 0), wide: wide * size, deep: deep * size };
  };
  const stations = [flat(0.1, 0.024, 0.015), flat(0.3, 0.036, 0.015), flat(0.48, 0.036, 0.012)];
  const parts: Part[] = [
    { form: "ball", joint, tone: "joint", at: ZERO, radius: 0.026 * size },
    { form: "loft", joint, tone: "body", stations, side: front, boxy: 2.8 },
  ];
  return jointed ? parts : [...parts, ...digits(at, front, size).map((digit): Part => ({ ...digit, joint }))];
}

/** Slightly bent fingers and a thumb; `at` maps hand length, lateral and palm offsets to positions. */
function digits(at: (x: number, y: number, z: number) => V3, side: V3, size: number) {
  const tube = (points: readonly V3[], radius: number) => {
    const thin = (k: number) => (radius - 0.0008 * k) * size;
    const stations = points.map((p, k): Station => ({ at: p, wide: thin(k), deep: thin(k) }));
    return { form: "loft", tone: "body", stations, side, boxy: 2, fine: true } as const;
  };
  const fingers = FINGERS.map(([y, reach]) => {
    const [first, second] = [(0.96 + reach) / 3, (0.48 + 2 * reach) / 3];
    return tube([at(0.48, y, 0), at(first, y, 0.003), at(second, y, 0.011), at(reach, y * 0.92, 0.025)], 0.0092);
  });
  return [...fingers, tube([at(0.16, 0.026, 0.006), at(0.34, 0.046, 0.016), at(0.54, 0.052, 0.026)], 0.0115)];
}

/** Foot from heel to ball, with the sole below the toe joint. */
function foot(b: Build, joint: number): Part[] {
  const { anatomy: a, size } = b;
  const ball = ends(a, joint)[0];
  if (!ball) return [];
  const down = -dot(ball, a.up) + 0.016 * size;
  const level = sub(ball, scale(a.up, dot(ball, a.up)));
  const [ahead, long] = [unit(level, a.forward), length(level)];
  const at = (x: number, wide: number, high: number): Station => ({
    at: add(scale(ahead, x), scale(a.up, high * size - down)),
    wide: wide * size,
    deep: high * size,
  });
  const ankle = Math.min(down / size / 2 + 0.008, 0.062);
  const stations = [
    at(-0.05 * size, 0.024, 0.024),
    at(-0.025 * size, 0.032, ankle * 0.85),
    at(0.02 * size, 0.034, ankle),
    at(long * 0.6, 0.041, 0.031),
    at(long * 0.97, 0.044, 0.02),
  ];
  return [
    { form: "ball", joint, tone: "joint", at: ZERO, radius: 0.036 * size },
    { form: "loft", joint, tone: "body", stations, side: square(a.left, ahead), boxy: 2.5 },
  ];
}

function toe(b: Build, joint: number): Part[] {
  const { anatomy: a, size } = b;
  const end = ends(a, joint)[0] ?? scale(a.forward, 0.07 * size);
  const level = sub(end, scale(a.up, dot(end, a.up)));
  const [ahead, long] = [unit(level, a.forward), length(level)];
  const at = (x: number, wide: number, high: number): Station => ({
    at: add(scale(ahead, x * long), scale(a.up, (high - 0.016) * size)),
    wide: wide * size,
    deep: high * size,
  });
  const stations = [at(0.12, 0.044, 0.019), at(0.5, 0.041, 0.017), at(0.85, 0.031, 0.013)];
  return [{ form: "loft", joint, tone: "body", stations, side: square(a.left, ahead), boxy: 2.5 }];
}

/** Joint of the hand that a finger's joint belongs to. */
function handOf(a: Anatomy, joint: number): number {
  const parent = a.parents[joint] ?? -1;
  return a.regions[parent] === "finger" ? handOf(a, parent) : parent;
}

/** Whether a joint is part of the only chain of fingers of a hand, beside a thumb; the thumb starts nearer the wrist. */
function carriesAllFingers(a: Anatomy, joint: number): boolean {
  const digits = (a.children[handOf(a, joint)] ?? []).filter((child) => a.regions[child] === "finger");
  if (digits.length > 2) return false;
  const far = (child: number) => length(a.offsets[child] as V3);
  const longest = digits.reduce((one, other) => (far(other) > far(one) ? other : one), digits[0] as number);
  const first = (j: number): number => (a.regions[a.parents[j] ?? -1] === "finger" ? first(a.parents[j] as number) : j);
  return first(joint) === longest;
}

/** Segment of a finger; of four fingers side by side where one chain stands for them all. */
function finger(b: Build, joint: number): Part[] {
  const { anatomy: a, size } = b;
  const end = ends(a, joint)[0];
  if (!end) return [];
  const along = unit(end);
  const all = carriesAllFingers(a, joint);
  const front = all ? square(a.forward, along) : square([0, 1, 0], along);
  const last = (a.children[joint] ?? []).length === 0;
  const radius = (all ? 0.0092 : last ? 0.0105 : 0.009) * size;
  return (all ? FINGERS : [[0, 1] as const]).map(([y, reach]): Part => {
    const sideways = scale(front, y * size);
    const tip = add(scale(end, last && all ? 3 * reach - 2 : 1), sideways);
    const stations = [sideways, tip].map((at, k) => ({ at, wide: radius - 0.0008 * k * size, deep: radius }));
    return { form: "loft", joint, tone: "body", stations, side: front, boxy: 2, fine: true };
  });
}

/** Mannequin for a skeleton with human joint names. */
export function human(anatomy: Anatomy): Part[] {
  const b = buildOf(anatomy);
  const pieces: Partial<Record<Region, (build: Build, joint: number) => Part[]>> = {
    upperArm: (build, joint) => limb(build, joint, "upperArm"),
    forearm: (build, joint) => limb(build, joint, "forearm"),
    thigh: (build, joint) => limb(build, joint, "thigh"),
    shin: (build, joint) => limb(build, joint, "shin"),
    clavicle: collar,
    hand,
    foot,
    toe,
    finger,
  };
  return [...trunk(b), ...headAndNeck(b), ...anatomy.regions.flatMap((region, j) => pieces[region]?.(b, j) ?? [])];
}
