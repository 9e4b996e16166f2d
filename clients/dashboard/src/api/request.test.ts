import { createServer, type Server } from "node:http";
import type { AddressInfo } from "node:net";
import { AdverbError } from "adverb-client";
import { afterAll, beforeAll, beforeEach, expect, test } from "vitest";
import { Access } from "../access/access";
import { callerOf, Rest } from "./rest";

const GOOD = "adv_good";
const CALLER = { required: true, id: "1", name: "game", scopes: ["pose"], expires_at: null };
let server: Server;
let base: string;
let seen: string[];
let bodies: string[];

beforeAll(async () => {
  server = createServer(async (request, response) => {
    let body = "";
    for await (const part of request) body += part;
    seen.push(`${request.method} ${request.url} ${request.headers.authorization ?? "-"}`);
    const allowed = request.headers.authorization === `Bearer ${GOOD}`;
    if (allowed) bodies.push(body);
    const problem = '{"code": "unauthenticated", "detail": "this server needs a key"}';
    const answer = request.url === "/v1/access" ? JSON.stringify(CALLER) : '{"verbs": [], "id": "job"}';
    response.writeHead(allowed ? 200 : 401, { "Content-Type": "application/json" }).end(allowed ? answer : problem);
  });
  await new Promise<void>((done) => server.listen(0, "127.0.0.1", done));
  base = `http://127.0.0.1:${(server.address() as AddressInfo).port}`;
});
afterAll(() => void server.close());
beforeEach(() => {
  seen = [];
  bodies = [];
});

function open() {
  const access = new Access(null, (key) => callerOf(key, base));
  const problems: AdverbError[] = [];
  const rest = new Rest(base, access, (problem) => problems.push(problem));
  const prompted = new Promise<void>((done) => access.on(() => access.problem !== null && done()));
  return { access, rest, problems, prompted };
}

test("a request without a key is sent again, with its body, once there is one", async () => {
  const { access, rest, problems, prompted } = open();
  const started = rest.refine("reach", { budget_s: 7 });
  await prompted;
  expect(access.problem).toBe("this server needs a key");
  await expect(access.give("adv_bad")).rejects.toBeInstanceOf(AdverbError);
  await access.give(GOOD);
  expect(await started).toMatchObject({ id: "job" });
  expect(bodies.at(-1)).toBe('{"budget_s":7}');
  expect(seen.filter((line) => line.startsWith("POST"))).toEqual([
    "POST /v1/verbs/reach/refinements -",
    `POST /v1/verbs/reach/refinements Bearer ${GOOD}`,
  ]);
  expect(problems).toEqual([]);
});

test("while a key is needed nothing else is sent", async () => {
  const { access, rest, prompted } = open();
  const first = rest.verbs();
  await prompted;
  const second = rest.verbs();
  await new Promise((done) => setImmediate(done));
  expect(seen).toHaveLength(1);
  await access.give(GOOD);
  expect(await Promise.all([first, second])).toEqual([[], []]);
});

test("the key is in the header, and not in the address", async () => {
  const { access, rest } = open();
  await access.give(GOOD);
  await rest.download(rest.artifact("reach", 2));
  expect(seen.at(-1)).toBe(`GET /v1/verbs/reach/versions/2 Bearer ${GOOD}`);
});
