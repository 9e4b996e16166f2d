import fc from "fast-check";
import { expect, test } from "vitest";
import { ClipTime } from "./clip_time";

test("keytimes are at their phases, and time rises between them", () => {
  const gaps = fc.array(fc.double({ min: 0.05, max: 3, noNaN: true }), { minLength: 3, maxLength: 3 });
  fc.assert(
    fc.property(gaps, gaps, fc.boolean(), (widths, lengths, looping) => {
      const sums = (parts: number[]) => [0, 1, 2, 3].map((k) => parts.slice(0, k).reduce((sum, part) => sum + part, 0));
      const total = widths.reduce((sum, width) => sum + width, 0);
      const phases = sums(widths).map((each) => each / total);
      phases[3] = 1;
      const keytimes = sums(lengths);
      const time = new ClipTime(phases, keytimes, looping);
      for (const [k, phase] of phases.entries()) expect(time.at(phase)).toBeCloseTo(keytimes[k] as number, 9);
      const samples = Array.from({ length: 101 }, (_, k) => time.at(k / 100));
      for (let k = 1; k <= 100; k++) expect(samples[k]).toBeGreaterThanOrEqual((samples[k - 1] as number) - 1e-12);
    }),
  );
});

test("it equals the time-warp of the library", () => {
  // verbs.kernels.timewarp.time_at at phases 0.1, 0.3, 0.5, 0.8
  const time = new ClipTime([0, 0.4, 0.7, 1], [0, 1.2, 1.5, 3], false);
  const found = [0.1, 0.3, 0.5, 0.8].map((phase) => time.at(phase));
  LIBRARY.forEach((value, k) => {
    expect(found[k]).toBeCloseTo(value, 9);
  });
});

const LIBRARY = [0.39306478405315615, 1.0077657807308968, 1.3058570198105084, 1.8074074074074078];
