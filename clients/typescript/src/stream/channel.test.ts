/** Errors of a channel: which are answers to its `open`, and what follows them. */

import { describe, expect, test } from "vitest";
import type { Opened } from "../schema.js";
import { Channel } from "./channel.js";
import type { Motion } from "./motion.js";

const MOTION: Motion = {
  ...{ verb: "reach", method: "", names: ["x"], fps: 60, encoding: "f32" },
  ...{ playing: true, speed: 1, loop: true, seek: { serial: 0, phase: 0 } },
};
const OPENED = { channel: 1, verb: "reach", resumed: false } as Opened;

const ops = (channel: Channel, nowMs = 0) =>
  channel.next(MOTION, [0.5], 0, nowMs).map((message) => JSON.parse(message as string).op as string);

describe("an error while an open is unanswered", () => {
  test("of settings that were sent before is not its answer", () => {
    const channel = new Channel(1);
    expect(ops(channel)).toEqual(["open"]);
    expect(channel.answers("unknown_channel")).toBe(false);
    channel.refused("unknown_channel", Number.POSITIVE_INFINITY);
    expect(channel.pending).toBe(true);
    expect(channel.acceptOpened(OPENED)).toBe(true);
    expect(channel.isOpen).toBe(true);
  });

  test("of a server that is loading is answered by another open", () => {
    const channel = new Channel(1);
    ops(channel);
    channel.refused("not_ready", 1000);
    expect(ops(channel, 500)).toEqual([]);
    expect(ops(channel, 1500)).toEqual(["open"]);
  });

  test("of a server that has the channel is answered by close and open", () => {
    const channel = new Channel(1);
    ops(channel);
    channel.refused("channel_in_use", 0);
    expect(ops(channel)).toEqual(["close", "open"]);
    expect(channel.acceptOpened(OPENED)).toBe(true);
  });

  test("for any other reason ends it", () => {
    const channel = new Channel(1);
    ops(channel);
    channel.refused("unknown_verb", Number.POSITIVE_INFINITY);
    expect(channel.isOpen).toBe(false);
    expect(ops(channel, 1e9)).toEqual([]);
  });
});
