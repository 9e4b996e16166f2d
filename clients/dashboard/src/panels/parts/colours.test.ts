import { describe, expect, test } from "vitest";
import { gradient, indexOf, linearScale, logScale, PALETTE } from "./colours";

function linear(level: number): number {
  const share = level / 255;
  return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
}

/** Lightness L* of CIELAB, independent of OKLCH. */
function lightness(k: number): number {
  const [red = 0, green = 0, blue = 0] = [...PALETTE.subarray(3 * k, 3 * k + 3)].map(linear);
  const luminance = 0.2126 * red + 0.7152 * green + 0.0722 * blue;
  return 116 * Math.cbrt(luminance) - 16;
}

describe("colours", () => {
  test("lightness rises monotonically in similar steps", () => {
    const at = Array.from({ length: 17 }, (_, k) => lightness(Math.round((k * 255) / 16)));
    const steps = at.slice(1).map((value, k) => value - (at[k] ?? 0));
    expect(Math.min(...steps)).toBeGreaterThan(1.5);
    expect(Math.max(...steps)).toBeLessThan(6.5);
  });

  test("both ends differ from the light and dark page background", () => {
    expect(lightness(0)).toBeGreaterThan(16);
    expect(lightness(255)).toBeLessThan(92);
  });

  test("values beyond the ends are clamped", () => {
    expect([indexOf(-1), indexOf(0), indexOf(1), indexOf(7)]).toEqual([0, 0, 255, 255]);
    expect(gradient()).toMatch(/^linear-gradient\(to right, (rgb\(\d+ \d+ \d+\),?){17}\)$/);
  });
});

describe("scales", () => {
  test.each([
    [0.42, 0.6],
    [17.7, 20],
    [20, 20],
    [10.5, 12],
    [131, 160],
    [1, 1],
    [61, 80],
    [95, 100],
  ])("the linear scale for %f ends at %f", (most, end) => {
    const scale = linearScale(most);
    expect(scale.ticks.at(-1)).toBeCloseTo(end);
    expect(scale.ticks[0]).toBe(0);
    expect(scale.at(end / 2)).toBeCloseTo(0.5);
  });

  test("the logarithmic scale has whole decades around the values", () => {
    const scale = logScale([0.003, 0.01, 0.05, 0.4]);
    expect(scale.ticks.map((tick) => tick.toPrecision(2))).toEqual(["0.0010", "0.010", "0.10", "1.0"]);
    expect(scale.at(0.1)).toBeCloseTo(2 / 3);
  });

  test("a few small values do not extend it, and zero has the first colour", () => {
    const scale = logScale([0, 1e-12, ...Array.from({ length: 99 }, (_, k) => 0.02 + k / 1000)]);
    expect(scale.ticks[0]).toBeCloseTo(0.01);
    expect(scale.at(0)).toBe(0);
  });

  test("it is defined without values", () => {
    expect(logScale([]).ticks.length).toBeGreaterThan(1);
  });
});
