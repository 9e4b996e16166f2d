/** JSON text messages of the server, with `op`. */

import { DecodeError } from "../errors.js";
import type { components } from "../generated/schema.js";

export type ServerMessage = components["schemas"]["ServerMessage"];

type Kind = "number" | "string" | "object" | "boolean";

/** Fields that are used; other fields and ops are ignored. */
const FIELDS: Record<string, Record<string, Kind>> = {
  hello: { session: "string", max_channels: "number" },
  opened: { channel: "number", verb: "string", joints: "object", skeleton: "object", record_bytes: "number" },
  version: { channel: "number", version: "number", record_bytes: "number" },
  events: { items: "object" },
  end: { channel: "number" },
  pong: { t: "number", server_time_ns: "number" },
  stats: {
    ...{ seconds: "number", kbps: "number", budget_kbps: "number", records: "number", left_out: "number" },
    ...{ min_fps: "number", max_fps: "number" },
  },
  error: { code: "string", detail: "string" },
  drain: { reconnect_after_s: "number" },
};
const EVENT_FIELDS: Record<string, Kind> = { channel: "number", name: "string", phase: "number" };

export function readText(content: string): ServerMessage {
  let message: unknown;
  try {
    message = JSON.parse(content);
  } catch {
    throw new DecodeError(0, "a text message is not JSON");
  }
  if (typeof message !== "object" || message === null || !("op" in message) || typeof message.op !== "string")
    throw new DecodeError(0, "a text message has no op");
  checkFields(message, FIELDS[message.op] ?? {}, message.op);
  if (message.op === "events") {
    const { items } = message as unknown as { items: unknown };
    if (!Array.isArray(items)) throw new DecodeError(0, "events: 'items' is not an array");
    for (const item of items) checkFields(item ?? {}, EVENT_FIELDS, message.op);
  }
  return message as ServerMessage;
}

function checkFields(fields: object, kinds: Record<string, Kind>, op: string): void {
  for (const [name, kind] of Object.entries(kinds)) {
    const value = (fields as Record<string, unknown>)[name];
    if (typeof value !== kind || value === null) throw new DecodeError(0, `${op}: '${name}' is not a ${kind}`);
  }
}
