import { createServer, type IncomingMessage, type Server, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import { afterAll, beforeAll, expect, test, vi } from "vitest";
import { type AdverbError, DecodeError, TimedOut, TransportError, UnknownName } from "../errors.js";
import { Evaluators } from "../evaluator/evaluators.js";
import { Client } from "./client.js";

const ROUTES: Record<string, { status: number; type: string; body: string }> = {
  "GET /v1/verbs": { status: 200, type: "application/json", body: '{"verbs": [{"name": "reach"}]}' },
  "GET /v1/verbs/a%2Fb": {
    status: 404,
    type: "application/problem+json",
    body: '{"code": "unknown_verb", "detail": "unknown verb", "known": ["reach"], "status": 404}',
  },
  "POST /v1/verbs/reach/pose": {
    status: 422,
    type: "application/problem+json",
    body: '{"code": "invalid_request", "detail": "does not fit", "errors": [{"at": "adverbs.x", "problem": "no number"}]}',
  },
  "GET /metrics": { status: 502, type: "text/html", body: "<html>bad gateway" },
  "GET /v1/refinements?verb=reach&limit=5": { status: 200, type: "application/json", body: '{"refinements": []}' },
  "POST /v1/verbs/reach/sequence": { status: 200, type: "model/gltf-binary", body: "glTF" },
  "GET /v1/verbs/page": { status: 200, type: "text/html", body: "<html>login" },
  "DELETE /v1/verbs/reach": { status: 204, type: "", body: "" },
};
let server: Server;
let base: string;

beforeAll(async () => {
  server = createServer((request: IncomingMessage, response) => {
    const route = ROUTES[`${request.method} ${request.url}`];
    if (request.url?.includes("/silent")) return;
    if (request.url?.includes("/stalled")) return void response.writeHead(200, { "Content-Length": 1000 }).write("{");
    if (request.url?.includes("/cut")) return cut(response, request.url.includes("refused") ? 404 : 200);
    response.writeHead(route?.status ?? 500, { "Content-Type": route?.type ?? "text/plain" }).end(route?.body);
  });
  await new Promise<void>((done) => server.listen(0, "127.0.0.1", done));
  base = `http://127.0.0.1:${(server.address() as AddressInfo).port}`;
});
afterAll(() => {
  server.close();
  server.closeAllConnections();
});

/** A response whose connection breaks before its end. */
function cut(response: ServerResponse, status: number): void {
  response.writeHead(status, { "Content-Length": 1000 });
  response.write("{", () => response.destroy());
}

const failure = (promise: Promise<unknown>) => promise.catch((err: unknown) => err as AdverbError);

test("responses are unwrapped and names are escaped", async () => {
  const rest = new Client(base);
  expect((await rest.verbs()).map(({ name }) => name)).toEqual(["reach"]);
  expect(await rest.refinements({ verb: "reach", limit: 5 })).toEqual([]);
  expect(await rest.remove("reach")).toBeUndefined();
});

test("a problem has the code, detail, locations and known names of the response", async () => {
  const rest = new Client(base);
  const problem = await failure(rest.verb("a/b"));
  expect(problem).toBeInstanceOf(UnknownName);
  expect(problem).toMatchObject({ status: 404, code: "unknown_verb", known: ["reach"] });
  expect(await failure(rest.pose("reach", { adverbs: {} }))).toMatchObject({
    code: "invalid_request",
    detail: "does not fit: adverbs.x: no number",
  });
  expect(await failure(rest.metrics())).toMatchObject({ status: 502, code: "unknown" });
});

test("a missing response is a problem with code offline; an abort is not a problem", async () => {
  expect(await failure(new Client("http://127.0.0.1:1").verbs())).toMatchObject({ status: 0, code: "offline" });
  expect(await failure(new Client(base).verbs(AbortSignal.abort()))).toMatchObject({ name: "AbortError" });
});

test("a motion is requested as a file of a media type", async () => {
  const accept = new Promise<string | undefined>((done) =>
    server.once("request", (request: IncomingMessage) => done(request.headers.accept)),
  );
  const file = await new Client(base).sequence("reach", { adverbs: { x: 1 } }, undefined, "model/gltf-binary");
  expect(new TextDecoder().decode(file)).toBe("glTF");
  expect(await accept).toBe("model/gltf-binary");
});

test("a response that is not complete in time is TimedOut; an abort is not", async () => {
  const rest = new Client(base, { timeoutMs: 50 });
  expect(await failure(rest.verb("silent"))).toBeInstanceOf(TimedOut);
  expect(await failure(rest.verb("stalled"))).toBeInstanceOf(TimedOut);
  expect(await failure(rest.verb("silent", new AbortController().signal))).toBeInstanceOf(TimedOut);
  const stop = new AbortController();
  const stopped = failure(new Client(base).verb("silent", stop.signal));
  stop.abort();
  expect(await stopped).toMatchObject({ name: "AbortError" });
});

test("a response that is cut is a TransportError, one that is not JSON a DecodeError", async () => {
  const rest = new Client(base);
  for (const broken of [rest.verb("cut"), rest.verb("cut_refused"), rest.verbFile("cut"), rest.download("/cut")])
    expect(await failure(broken)).toBeInstanceOf(TransportError);
  expect(await failure(rest.verb("page"))).toBeInstanceOf(DecodeError);
});

test.each([
  ["that is cut", "offline", () => new Client(base).verbFile("cut")],
  ["with another error", "unknown", () => Promise.reject(new TypeError("terminated"))],
])("a download %s is a failure of its version", async (_, code, verbFile) => {
  const evaluators = new Evaluators({ verbFile });
  expect(evaluators.of("cut", 1)).toBeNull();
  await vi.waitFor(() => expect(evaluators.failure("cut", 1)).toMatchObject({ code }));
});
