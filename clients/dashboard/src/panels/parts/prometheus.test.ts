import { describe, expect, test } from "vitest";
import { buckets, countOf, mean, parse, quantile, since, total } from "./prometheus";

const TEXT = String.raw`# HELP late_seconds How late.
# TYPE late_seconds histogram
late_seconds_bucket{le="0.1",verb="a"} 2.0
late_seconds_bucket{le="1.0",verb="a"} 6.0
late_seconds_bucket{le="+Inf",verb="a"} 8.0
late_seconds_sum{verb="a"} 7.5
late_seconds_bucket{le="0.1",verb="b"} 1.0
late_seconds_bucket{le="1.0",verb="b"} 1.0
late_seconds_bucket{le="+Inf",verb="b"} 1.0
late_seconds_sum{verb="b"} 0.05
open 3 1700000000000
tiny{why="a \"b\", {c}=d\\e\nf"} 1.5e-07
not a sample at all
`;

const samples = parse(TEXT);
const only = (verb: string) => (labels: Readonly<Record<string, string>>) => labels.verb === verb;
const seconds = (counts: number[], sum = 0) => ({ bounds: [0.1, 1, Number.POSITIVE_INFINITY], counts, sum });

describe("reading", () => {
  test("samples have names, labels and values; other lines are skipped", () => {
    expect(samples).toHaveLength(10);
    expect(samples[0]).toEqual({ name: "late_seconds_bucket", labels: { le: "0.1", verb: "a" }, value: 2 });
    expect(total(samples, "open")).toBe(3);
  });

  test("escaped labels keep quotes, commas, braces, backslashes and line feeds", () => {
    expect(samples.at(-1)).toEqual({ name: "tiny", labels: { why: 'a "b", {c}=d\\e\nf' }, value: 1.5e-7 });
  });

  test("only wanted metrics are parsed", () => {
    expect(parse(TEXT, (name) => name === "open")).toHaveLength(1);
  });

  test("a missing metric is NaN", () => {
    expect(total(samples, "nothing")).toBeNaN();
  });
});

describe("histograms", () => {
  test("matching labels are summed, and bounds ascend to infinity", () => {
    expect(buckets(samples, "late_seconds")).toEqual(seconds([3, 7, 9], 7.55));
    expect(buckets(samples, "late_seconds", only("b")).counts).toEqual([1, 1, 1]);
  });

  test("the increase is the difference of two scrapes", () => {
    const came = since(seconds([3, 7, 9], 9), seconds([2, 6, 6], 4));
    expect(came).toEqual(seconds([1, 1, 3], 5));
    expect(countOf(came)).toBe(3);
    expect(mean(came)).toBeCloseTo(5 / 3);
  });

  test("after a server restart the increase is the whole histogram", () => {
    const now = seconds([1, 2, 2], 0.5);
    expect(since(now, seconds([5, 9, 9], 4))).toEqual(now);
  });

  test("a new series starts at zero", () => {
    expect(since(seconds([1, 2, 2], 0.5), { bounds: [], counts: [], sum: 0 }).counts).toEqual([1, 2, 2]);
  });
});

describe("quantiles", () => {
  test("quantiles are linear within a bucket, and the first bucket starts at zero", () => {
    expect(quantile(seconds([10, 10, 10]), 0.5)).toBeCloseTo(0.05);
    expect(quantile(seconds([5, 10, 10]), 0.75)).toBeCloseTo(0.55);
    expect(quantile(seconds([5, 10, 10]), 1)).toBeCloseTo(1);
  });

  test("empty buckets are skipped", () => {
    const split = { bounds: [1, 2, 3, Number.POSITIVE_INFINITY], counts: [5, 5, 10, 10], sum: 0 };
    expect(quantile(split, 0.5)).toBe(1);
    expect(quantile(split, 0.6)).toBeCloseTo(2.2);
  });

  test("beyond the last finite bound the quantile is that bound", () => {
    expect(quantile(seconds([0, 1, 10]), 0.99)).toBe(1);
  });

  test("an empty histogram has no quantile", () => {
    expect(quantile(seconds([0, 0, 0]), 0.5)).toBeNaN();
    expect(mean(seconds([0, 0, 0]))).toBeNaN();
  });
});
