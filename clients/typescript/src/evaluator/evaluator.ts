/**
 * Evaluation of a verb without a server: weights and phase, or adverbs by `rbf` or `refined`, to poses.
 *
 * The poses are those of the server with `plant: false`.
 */

import { BadRequest, UnknownName } from "../errors.js";
import { clamp } from "../math/chart.js";
import { type Rig, rigOf, type Skeleton, solve } from "../math/kinematics.js";
import { multiply } from "../math/quaternion.js";
import { weightsAt } from "./basis.js";
import { readContainer, verify } from "./container.js";
import { blendCurves } from "./curves.js";
import { logLengthsOf, TimeWarp } from "./timewarp.js";
import { type Place, Walk } from "./travel.js";
import { type StoredVerb, verbOf } from "./verb_file.js";

export type EvaluatorMethod = "rbf" | "refined";

/** An instant: a phase, 0 to 1 (beyond in further cycles of a loop), or seconds from the start; default: the start. */
export interface Instant {
  phase?: number;
  timeS?: number;
}

/** Weights of the examples; they sum to 1 and may be negative. */
export interface Blend {
  weights: Float64Array;
  /** Whether the adverbs were outside the domain and were moved back. */
  clamped: boolean;
}

export interface EvaluatedPose {
  weights: ArrayLike<number>;
  clamped: boolean;
  /** Canonical time; beyond 1 in further cycles of a loop. */
  phase: number;
  timeS: number;
  /** Seconds per motion or cycle. */
  durationS: number;
  /** Root x, y, z (m), then local x, y, z, w per joint. */
  values: Float64Array;
  skeleton: Skeleton;
}

const MAX_CYCLES = 1000;
const MAX_TIME_S = 3600;

export class Evaluator {
  /** The verb as stored: adverbs, skeleton, keytimes, examples. */
  readonly verb: StoredVerb;
  private readonly rig: Rig;
  private readonly logLengths: Float64Array;
  private readonly sums: Float64Array;

  constructor(verb: StoredVerb) {
    this.verb = verb;
    this.rig = rigOf(verb.skeleton);
    this.logLengths = logLengthsOf(verb.keytimes, verb.phases.length);
    this.sums = new Float64Array(4 + 4 * this.rig.joints);
  }

  /**
   * Read a verb file, as `Client.verbFile` downloads it, and compare its checksum where the platform has SHA-256.
   *
   * @throws ArtifactError it is not a verb file, is damaged, or has a newer format
   */
  static async load(content: ArrayBuffer | Uint8Array): Promise<Evaluator> {
    const container = readContainer(content);
    await verify(container);
    return new Evaluator(verbOf(container));
  }

  /** Numbers of a pose: 3 + 4·J. */
  get poseLength(): number {
    return 3 + 4 * this.rig.joints;
  }

  /**
   * Weights at adverbs: by name, or all of them in the verb's order.
   *
   * @throws UnknownName no adverb of a name
   * @throws BadRequest an adverb is missing or not finite
   */
  blend(adverbs: Readonly<Record<string, number>> | ArrayLike<number>, method: EvaluatorMethod = "rbf"): Blend {
    const row = this.adverbsOf(adverbs);
    const inside = new Float64Array(row.length);
    const clamped = clamp(this.verb.domain, row, inside);
    const { bases } = this.verb;
    const basis = (method === "refined" ? bases.refined : undefined) ?? bases.rbf;
    if (!basis) throw new UnknownName(0, "unknown_method", `the verb has no basis for '${method}'`);
    const weights = new Float64Array(this.verb.examples.length);
    weightsAt(basis, inside, weights);
    return { weights, clamped };
  }

  /** Pose at adverbs. */
  pose(
    adverbs: Readonly<Record<string, number>> | ArrayLike<number>,
    { method = "rbf", ...instant }: Instant & { method?: EvaluatorMethod } = {},
  ): EvaluatedPose {
    const { weights, clamped } = this.blend(adverbs, method);
    return { ...this.poseOf(weights, instant), clamped };
  }

  /** Pose of weights, as records with the encoding `weights` have them. */
  poseOf(weights: ArrayLike<number>, instant: Instant = {}): EvaluatedPose {
    if (weights.length !== this.verb.examples.length)
      throw new BadRequest(0, "out_of_range", `the verb has ${this.verb.examples.length} examples`);
    const clock = this.clock(weights);
    const { phase, timeS } = this.resolve(clock, instant);
    const values = new Float64Array(this.poseLength);
    const { strides, looping } = this.verb;
    this.write(weights, phase, strides ? new Walk(strides, weights, looping).placeAt(phase) : null, values);
    return { weights, clamped: false, phase, timeS, durationS: clock.durationS, values, skeleton: this.verb.skeleton };
  }

  /**
   * Write the pose of weights at a phase to `out` (`poseLength`), without allocations.
   *
   * @param place where a root that travels is; it has no effect on other verbs
   */
  write(weights: ArrayLike<number>, phase: number, place: Place | null, out: Float32Array | Float64Array): void {
    blendCurves(this.verb, weights, this.verb.looping ? phase % 1 : phase, this.sums, out);
    if (place && this.verb.strides) put(place, out);
  }

  /** Move the place of a root that travels from a phase to another; unwrapped phases. */
  travel(weights: ArrayLike<number>, from: number, to: number, place: Place): void {
    const { strides, looping } = this.verb;
    if (strides && from !== to) new Walk(strides, weights, looping).advance(from, to, place);
  }

  /** Seconds and phases of weights. */
  clock(weights: ArrayLike<number>): TimeWarp {
    return new TimeWarp(this.verb.phases, this.logLengths, this.verb.looping, weights);
  }

  /** Joint positions of a pose, 3 per joint, m; written to `positions` and `rotations` (global) where given. */
  positions(
    values: ArrayLike<number>,
    positions = new Float64Array(3 * this.rig.joints),
    rotations = new Float64Array(4 * this.rig.joints),
  ): Float64Array {
    solve(this.rig, values as Float64Array, 0, positions, rotations);
    return positions;
  }

  private resolve(clock: TimeWarp, { phase, timeS }: Instant): { phase: number; timeS: number } {
    const { looping } = this.verb;
    if (phase !== undefined && timeS !== undefined)
      throw new BadRequest(0, "bad_request", "give a phase or a time, not both");
    const given = timeS ?? phase ?? 0;
    const most = timeS !== undefined ? MAX_TIME_S : looping ? MAX_CYCLES : 1;
    if (!(given >= 0 && given <= most)) throw new BadRequest(0, "out_of_range", `${given} is not in 0 to ${most}`);
    const whole = timeS !== undefined ? clock.durationS : 1;
    const cycles = looping ? Math.floor(given / whole) : 0;
    const rest = Math.min(Math.max(given - cycles * whole, 0), whole);
    const local = timeS !== undefined ? clock.phaseAt(rest) : rest;
    const seconds = timeS !== undefined ? rest : clock.timeAt(rest);
    return { phase: local + cycles, timeS: seconds + cycles * clock.durationS };
  }

  private adverbsOf(given: Readonly<Record<string, number>> | ArrayLike<number>): ArrayLike<number> {
    const names = this.verb.adverbs.map(({ name }) => name);
    const row = isRow(given) ? given : this.named(names, given);
    if (row.length !== names.length)
      throw new BadRequest(0, "out_of_range", `the verb has the adverbs ${names.join(", ")}`);
    for (let a = 0; a < row.length; a++)
      if (!Number.isFinite(row[a])) throw new BadRequest(0, "out_of_range", `adverb '${names[a]}' is ${row[a]}`);
    return row;
  }

  private named(names: readonly string[], given: Readonly<Record<string, number>>): number[] {
    for (const name of Object.keys(given))
      if (!names.includes(name))
        throw new UnknownName(0, "unknown_adverb", `unknown adverb ${name}; there are ${names.join(", ")}`, names);
    return names.map((name) => {
      const value = given[name];
      if (value === undefined) throw new BadRequest(0, "bad_request", `missing adverb ${name}`);
      return value;
    });
  }
}

function isRow(given: Readonly<Record<string, number>> | ArrayLike<number>): given is ArrayLike<number> {
  return Array.isArray(given) || ArrayBuffer.isView(given);
}

/** Move a pose, whose root has a height and no heading, to its place in the world. */
function put({ x, z, heading, height }: Place, values: Float32Array | Float64Array): void {
  values[0] = x;
  values[1] = (values[1] as number) + height;
  values[2] = z;
  multiply(values, 3, [0, Math.sin(0.5 * heading), 0, Math.cos(0.5 * heading)], 0, values, 3);
}
