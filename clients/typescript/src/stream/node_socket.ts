/**
 * WebSocket client (RFC 6455) for Node 20 and 21, which have none. Node's modules are taken from the process, so that
 * bundlers for pages do not look for them.
 */

import type { ClientRequest, IncomingMessage } from "node:http";
import type { Duplex } from "node:stream";
import type { Socket } from "./reconnector.js";

const CONTINUATION = 0;
const TEXT = 1;
const BINARY = 2;
const CLOSE = 8;
const PING = 9;
const PONG = 10;
const ABNORMAL = 1006;
const MOST_BYTES = 64 * 1024 * 1024;
/** Time in which the server has to answer a close frame, ms. */
const CLOSE_MS = 1000;

type Handler = ((event: never) => unknown) | null;

/** Whether this is a Node whose modules can be taken. */
export function nodeSocketsExist(): boolean {
  return typeof process !== "undefined" && typeof process.getBuiltinModule === "function";
}

export class NodeSocket implements Pick<Socket, "send" | "close"> {
  binaryType: BinaryType = "arraybuffer";
  onopen: Handler = null;
  onmessage: Handler = null;
  onclose: Handler = null;
  private readonly request: ClientRequest;
  private stream: Duplex | null = null;
  private received: Buffer[] = [];
  private size = 0;
  private parts: Buffer[] = [];
  private kind = BINARY;
  private ended = false;

  constructor(address: string, protocols: readonly string[]) {
    const url = new URL(address.replace(/^ws/, "http"));
    const http = process.getBuiltinModule(url.protocol === "https:" ? "node:https" : "node:http");
    const key = Buffer.from(crypto.getRandomValues(new Uint8Array(16))).toString("base64");
    this.request = http.request(url, {
      headers: {
        Connection: "Upgrade",
        Upgrade: "websocket",
        "Sec-WebSocket-Key": key,
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": protocols.join(", "),
      },
    });
    this.request.on("upgrade", (response, stream, head) => this.upgraded(key, response, stream, head));
    this.request.on("response", (response) => {
      response.resume();
      this.end(ABNORMAL, `the server refused the stream with status ${response.statusCode}`);
    });
    this.request.on("error", (err) => this.end(ABNORMAL, err.message || "the server cannot be reached"));
    this.request.end();
  }

  send(message: string | ArrayBufferLike | Blob | ArrayBufferView): void {
    if (typeof message === "string") this.frame(TEXT, Buffer.from(message));
    else if (message instanceof ArrayBuffer) this.frame(BINARY, Buffer.from(message));
    else throw new TypeError("messages are strings or array buffers");
  }

  close(code = 1000): void {
    if (!this.stream) {
      this.request.destroy();
      return this.end(code, "");
    }
    const content = Buffer.alloc(2);
    content.writeUInt16BE(code);
    this.frame(CLOSE, content);
    setTimeout(() => this.stream?.destroy(), CLOSE_MS).unref();
  }

  private upgraded(key: string, response: IncomingMessage, stream: Duplex, head: Buffer): void {
    const hash = process.getBuiltinModule("node:crypto").createHash("sha1");
    const expected = hash.update(`${key}258EAFA5-E914-47DA-95CA-C5AB0DC85B11`).digest("base64");
    if (response.headers["sec-websocket-accept"] !== expected) {
      stream.destroy();
      return this.end(ABNORMAL, "the response is not a WebSocket handshake");
    }
    this.stream = stream;
    if ("setNoDelay" in stream) (stream as unknown as { setNoDelay(on: boolean): void }).setNoDelay(true);
    stream.on("data", (part: Buffer) => this.read(part));
    stream.on("error", () => {}); // `close` follows
    stream.on("close", () => this.end(ABNORMAL, ""));
    this.onopen?.({} as never);
    if (head.length > 0) this.read(head);
  }

  private read(part: Buffer): void {
    this.received.push(part);
    this.size += part.length;
    for (;;) {
      if (this.size < 2 || this.ended) return;
      const all = this.received.length === 1 ? (this.received[0] as Buffer) : Buffer.concat(this.received, this.size);
      this.received = [all];
      const short = (all[1] as number) & 127;
      const start = short === 126 ? 4 : short === 127 ? 10 : 2;
      if (all.length < start) return;
      const length = short === 126 ? all.readUInt16BE(2) : short === 127 ? Number(all.readBigUInt64BE(2)) : short;
      if (length > MOST_BYTES) return void this.stream?.destroy();
      if (all.length < start + length) return;
      const content = all.subarray(start, start + length);
      this.received = [all.subarray(start + length)];
      this.size = all.length - start - length;
      this.take((all[0] as number) & 15, ((all[0] as number) & 128) !== 0, content);
    }
  }

  private take(op: number, last: boolean, content: Buffer): void {
    if (op === PING) return this.frame(PONG, content);
    if (op === CLOSE) {
      this.frame(CLOSE, content.subarray(0, 2));
      this.stream?.end();
      const code = content.length >= 2 ? content.readUInt16BE(0) : 1005;
      return this.end(code, content.subarray(2).toString());
    }
    if (op !== TEXT && op !== BINARY && op !== CONTINUATION) return;
    if (op !== CONTINUATION) {
      this.kind = op;
      this.parts = [];
    }
    this.parts.push(content);
    if (!last) return;
    const whole = this.parts.length === 1 ? content : Buffer.concat(this.parts);
    this.parts = [];
    const data = this.kind === TEXT ? whole.toString() : new Uint8Array(whole).buffer;
    this.onmessage?.({ data } as never);
  }

  /** Clients mask their frames. */
  private frame(op: number, content: Buffer): void {
    if (!this.stream || this.stream.destroyed || this.stream.writableEnded) return;
    const { length } = content;
    const wide = length < 126 ? 0 : length < 65_536 ? 2 : 8;
    const out = Buffer.alloc(6 + wide + length);
    out[0] = 128 | op;
    out[1] = 128 | (wide === 0 ? length : wide === 2 ? 126 : 127);
    if (wide === 2) out.writeUInt16BE(length, 2);
    if (wide === 8) out.writeBigUInt64BE(BigInt(length), 2);
    const mask = crypto.getRandomValues(out.subarray(2 + wide, 6 + wide));
    for (let k = 0; k < length; k++) out[6 + wide + k] = (content[k] as number) ^ (mask[k % 4] as number);
    this.stream.write(out);
  }

  private end(code: number, reason: string): void {
    if (this.ended) return;
    this.ended = true;
    this.onclose?.({ code, reason } as never);
  }
}
