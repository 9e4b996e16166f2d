/** The parts of a verb file that evaluation needs, checked. */

import { ArtifactError } from "../errors.js";
import type { Chart, Domain } from "../math/chart.js";
import type { Skeleton } from "../math/kinematics.js";
import type { Container, StoredArray } from "./container.js";

/** Cardinal basis: adverbs in, one weight per example out. */
export interface Basis {
  chart: Chart;
  /** Number of the radial function. */
  kernel: number;
  /** Degree of the polynomial, 0 to 2. */
  degree: number;
  /** Centers: C × D, their radii: C, coefficients: C × N and L × N. */
  centers: Float64Array;
  radii: Float64Array;
  radial: Float64Array;
  poly: Float64Array;
}

export interface StoredAdverb {
  name: string;
  unit: string;
  description: string;
  /** It cannot be measured. */
  style: boolean;
  min: number;
  max: number;
}

export interface StoredVerb {
  name: string;
  description: string;
  looping: boolean;
  skeleton: Skeleton;
  adverbs: readonly StoredAdverb[];
  examples: readonly string[];
  /** Adverbs of the examples, N × D. */
  values: Float64Array;
  keytimeNames: readonly string[];
  /** Canonical time of the keytimes, M. */
  phases: Float64Array;
  /** Seconds of the examples' keytimes, N × M. */
  keytimes: Float64Array;
  /** Number of intervals of the curves. */
  intervals: number;
  /** (K + 3)·N rows of 4 + 4·J numbers. */
  curves: Float32Array;
  /** Reference rotation of each joint, J × 4. */
  references: Float64Array;
  /** Whether rows are rotation vectors. */
  vectors: boolean;
  /** Steps of a root that travels, K × N × 4: sideways, forward, turn, rise; null where its position is blended. */
  strides: Float64Array | null;
  domain: Domain;
  bases: Readonly<Record<string, Basis>>;
}

interface Facts {
  name: string;
  description: string;
  looping: boolean;
  joints: string[];
  adverbs: { name: string; unit: string; description: string; style: boolean }[];
  ranges: [number, number][];
  examples: string[];
  keytime_names: string[];
  rotation_mode: number;
  root_motion: number;
  domain: { chart: number; sharpness: number };
  bases: Record<string, { chart: number; kernel: number; degree: number }>;
}

const FACTS = [
  ...["name", "description", "looping", "joints", "adverbs", "ranges", "examples", "keytime_names"],
  ...["rotation_mode", "root_motion", "domain", "bases"],
];

/** @throws ArtifactError the file does not describe a verb */
export function verbOf({ facts: given, arrays }: Container): StoredVerb {
  for (const name of FACTS) if (!(name in given)) throw new ArtifactError(`the file does not describe a verb: ${name}`);
  const facts = given as unknown as Facts;
  const read = new Reader(arrays);
  const [count, joints] = [facts.examples.length, facts.joints.length];
  const dims = facts.adverbs.length;
  const curves = read.array("curves", [-1, count, 4 + 4 * joints]);
  const intervals = (curves.shape[0] as number) - 3;
  const phases = read.float64("phases", [facts.keytime_names.length]);
  const ranges = facts.ranges.length === dims ? facts.ranges : [];
  if (intervals < 1 || count < 1 || phases.length < 2 || ranges.length !== dims)
    throw new ArtifactError("the file does not describe a verb: sizes");
  const parents = read.float64("skeleton.parents", [joints]);
  if (!parents.every((parent, j) => Number.isInteger(parent) && parent >= (j ? 0 : -1) && parent < j))
    throw new ArtifactError("the file does not describe a verb: parents");
  return {
    name: facts.name,
    description: facts.description,
    looping: facts.looping,
    skeleton: {
      names: facts.joints,
      parents: [...parents],
      offsets: rowsOf(read.float64("skeleton.offsets", [joints, 3]), 3),
    },
    adverbs: facts.adverbs.map((row, k) => {
      const [min, max] = ranges[k] as [number, number];
      return { ...row, min, max };
    }),
    examples: facts.examples,
    values: read.float64("values", [count, dims]),
    keytimeNames: facts.keytime_names,
    phases,
    keytimes: read.float64("keytimes", [count, phases.length]),
    intervals,
    curves: curves.data as Float32Array,
    references: read.float64("references", [joints, 4]),
    vectors: facts.rotation_mode === 1,
    strides: facts.root_motion === 1 ? read.strides(intervals, count) : null,
    domain: {
      chart: read.chart("domain", facts.domain.chart, dims),
      facets: read.float64("domain.facets", [-1, dims]),
      middle: read.float64("domain.middle", [dims]),
      sharpness: facts.domain.sharpness,
    },
    bases: Object.fromEntries(
      Object.entries(facts.bases).map(([name, row]) => [name, read.basis(name, row, dims, count)]),
    ),
  };
}

/** Arrays of a file by name and shape; −1 stands for any length. */
class Reader {
  constructor(private readonly arrays: ReadonlyMap<string, StoredArray>) {}

  array(name: string, shape: readonly number[]): StoredArray {
    const found = this.arrays.get(name);
    const fits =
      found?.shape.length === shape.length && shape.every((side, k) => side === -1 || found.shape[k] === side);
    if (!found || !fits) throw new ArtifactError(`the file does not describe a verb: array '${name}'`);
    return found;
  }

  float64(name: string, shape: readonly number[]): Float64Array {
    const { data } = this.array(name, shape);
    if (data instanceof Float64Array) return data;
    throw new ArtifactError(`the file does not describe a verb: type of array '${name}'`);
  }

  chart(prefix: string, kind: number, dims: number): Chart {
    const part = (name: string, length: number) => this.float64(`${prefix}.chart.${name}`, [length]);
    return {
      kind,
      axes: part("axes", 3),
      bend: part("bend", 4),
      shift: part("shift", dims),
      scale: part("scale", dims),
    };
  }

  basis(name: string, row: Facts["bases"][string], dims: number, count: number): Basis {
    const prefix = `bases.${name}`;
    const features = [1, dims + 1, 1 + dims + (dims * (dims + 1)) / 2][row.degree];
    if (features === undefined || !(row.kernel >= 0 && row.kernel <= 5))
      throw new ArtifactError(`the file does not describe a verb: basis '${name}'`);
    const radii = this.float64(`${prefix}.radii`, [-1]);
    return {
      chart: this.chart(prefix, row.chart, dims),
      kernel: row.kernel,
      degree: row.degree,
      centers: this.float64(`${prefix}.centers`, [radii.length, dims]),
      radii,
      radial: this.float64(`${prefix}.radial`, [radii.length, count]),
      poly: this.float64(`${prefix}.poly`, [features, count]),
    };
  }

  /** Steps K × N × 4; rises are stored where a verb climbs. */
  strides(intervals: number, count: number): Float64Array {
    const planar = this.float64("strides", [intervals, count, 3]);
    const rises = this.arrays.has("rises") ? this.float64("rises", [intervals, count]) : null;
    const out = new Float64Array(4 * intervals * count);
    for (let k = 0; k < intervals * count; k++) {
      for (let a = 0; a < 3; a++) out[4 * k + a] = planar[3 * k + a] as number;
      out[4 * k + 3] = rises?.[k] ?? 0;
    }
    return out;
  }
}

function rowsOf(flat: Float64Array, width: number): number[][] {
  return Array.from({ length: flat.length / width }, (_, k) => [...flat.subarray(width * k, width * (k + 1))]);
}
