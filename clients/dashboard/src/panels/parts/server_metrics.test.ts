import { expect, test } from "vitest";
import { between, scrapeOf } from "./server_metrics";

function text(seconds: number): string {
  const quick = 'adverb_request_duration_seconds_bucket{le="0.01",method="none",route="/v1/verbs",verb="none"}';
  const endless = 'adverb_request_duration_seconds_bucket{le="0.01",route="/v1/refinements/{id}/events",verb="none"}';
  return `
${quick} ${4 * seconds}
${quick.replace("0.01", "+Inf")} ${4 * seconds}
${endless} 0
${endless.replace("0.01", "+Inf")} ${7 * seconds}
adverb_stream_frames_total ${60 * seconds}
adverb_stream_frames_dropped_total ${seconds}
adverb_poses_total{method="rbf",verb="reach"} ${120 * seconds}
adverb_poses_total{method="corrected",verb="arm3"} ${30 * seconds}
adverb_streams 2
adverb_channels 5
adverb_pose_error_meters_bucket{le="+Inf",method="rbf",verb="reach",version="1"} ${10 * seconds}
adverb_pose_error_meters_sum{method="rbf",verb="reach",version="1"} ${2 * seconds}
adverb_pose_error_meters_bucket{le="+Inf",method="rbf",verb="arm3",version="1"} 3
adverb_pose_error_meters_sum{method="rbf",verb="arm3",version="1"} 9
`;
}

const metrics = between(scrapeOf(text(10), 100), scrapeOf(text(12), 102));

test("counters become rates, gauges are kept", () => {
  expect(metrics).toMatchObject({ framesPerS: 60, droppedPerS: 1, posesPerS: 150, streams: 2, characters: 5 });
});

test("event streams are excluded from the latency", () => {
  expect(metrics.requests).toEqual([0.005, expect.closeTo(0.0095), expect.closeTo(0.0099)]);
});

test("the error of a verb is the mean since the last scrape, NaN without data", () => {
  expect(metrics.errors.get("reach")).toBeCloseTo(0.2);
  expect(metrics.errors.get("arm3")).toBeNaN();
});

test("a server restart gives no negative rates", () => {
  expect(between(scrapeOf(text(12), 100), scrapeOf(text(1), 102)).framesPerS).toBe(0);
});
