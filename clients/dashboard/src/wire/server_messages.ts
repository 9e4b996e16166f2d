/** JSON text messages of the server, with `op`. */

import type { components } from "../generated/schema";
import { DecodeError } from "./decode";

export type ServerMessage = components["schemas"]["ServerMessage"];

type Kind = "number" | "string" | "object" | "boolean";

/** Fields used by the page; other fields and ops are ignored. */
const FIELDS: Record<string, Record<string, Kind>> = {
  hello: { session: "string", max_channels: "number" },
  opened: { channel: "number", verb: "string", joints: "object", skeleton: "object", record_bytes: "number" },
  version: { channel: "number", version: "number", record_bytes: "number" },
  event: { channel: "number", name: "string", phase: "number" },
  end: { channel: "number" },
  pong: { t: "number", server_time_ns: "number" },
  error: { code: "string", detail: "string" },
  drain: { reconnect_after_s: "number" },
};

export function readText(content: string): ServerMessage {
  let message: unknown;
  try {
    message = JSON.parse(content);
  } catch {
    throw new DecodeError(0, "a text message is not JSON");
  }
  if (typeof message !== "object" || message === null || !("op" in message) || typeof message.op !== "string")
    throw new DecodeError(0, "a text message has no op");
  for (const [name, kind] of Object.entries(FIELDS[message.op] ?? {})) {
    const value = (message as Record<string, unknown>)[name];
    if (typeof value !== kind || value === null) throw new DecodeError(0, `${message.op}: '${name}' is not a ${kind}`);
  }
  return message as ServerMessage;
}
