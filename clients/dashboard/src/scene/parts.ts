import type { V3 } from "./vec";

/** The two tones of a mannequin. */
export type Tone = "body" | "joint";

/** Cross-section: centre, half-width and half-depth, m. */
export interface Station {
  readonly at: V3;
  readonly wide: number;
  readonly deep: number;
}

/** Smooth surface through cross-sections, rounded at both ends. */
export interface Loft {
  readonly form: "loft";
  readonly stations: readonly Station[];
  /** Direction of `wide`; `deep` is perpendicular to it and to the axis. */
  readonly side: V3;
  /** Superellipse exponent: 2 is an ellipse, more a rounded box. */
  readonly boxy: number;
}

export interface Ball {
  readonly form: "ball";
  readonly at: V3;
  readonly radius: number;
}

/** Flat link with round ends, perpendicular to `normal`. */
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

/** One part of a mannequin, fixed to a joint, in the joint's frame. */
export type Part = (Loft | Ball | Bar | Pin) & {
  readonly joint: number;
  readonly tone: Tone;
  /** Omitted at low detail. */
  readonly fine?: boolean;
};
