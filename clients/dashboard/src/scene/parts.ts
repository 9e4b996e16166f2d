import type { V3 } from "./vec";

/** The two materials of a mannequin. */
export type Tone = "body" | "joint";

/** A cross-section: its centre, and how far it goes to the side and to the front, m. */
export interface Station {
  readonly at: V3;
  readonly wide: number;
  readonly deep: number;
}

/** A smooth skin over cross-sections, rounded at both ends. */
export interface Loft {
  readonly form: "loft";
  readonly stations: readonly Station[];
  /** Where `wide` points; `deep` is square to it and to the loft's axis. */
  readonly side: V3;
  /** 2: ellipses; more: boxes with round corners. */
  readonly boxy: number;
}

export interface Ball {
  readonly form: "ball";
  readonly at: V3;
  readonly radius: number;
}

/** A flat link with round ends, square to `normal`. */
export interface Bar {
  readonly form: "bar";
  readonly from: V3;
  readonly to: V3;
  readonly normal: V3;
  readonly radius: number;
  readonly tip: number;
  readonly thick: number;
}

export interface Pin {
  readonly form: "pin";
  readonly at: V3;
  readonly axis: V3;
  readonly radius: number;
  readonly high: number;
}

/** One piece of a mannequin, fixed to a joint, in the joint's frame. */
export type Part = (Loft | Ball | Bar | Pin) & {
  readonly joint: number;
  readonly tone: Tone;
  /** Left out where detail is low. */
  readonly fine?: boolean;
};
