import { ResponseError } from "adverb-client";
import { beforeEach, expect, test } from "vitest";
import { Access, type Caller } from "./access";

const POSE: Caller = { required: true, id: "1", name: "game", scopes: ["pose"], expires_at: null };
let holders: Record<string, Caller>;
let stored: Map<string, string>;

function open(): Access {
  const storage = {
    getItem: (name: string) => stored.get(name) ?? null,
    setItem: (name: string, value: string) => void stored.set(name, value),
    removeItem: (name: string) => void stored.delete(name),
  };
  return new Access(storage, async (key) => {
    const holder = holders[key];
    if (!holder) throw new ResponseError(401, "unauthenticated", "the key is unknown");
    return holder;
  });
}

beforeEach(() => {
  holders = { adv_1: POSE, adv_2: { ...POSE, id: "2", scopes: ["admin"] } };
  stored = new Map();
});

test("a key is kept for the tab once the server has accepted it", async () => {
  const access = open();
  await expect(access.give("adv_9")).rejects.toThrow("unknown");
  expect([...stored.values()]).toEqual([]);
  await access.give("  adv_1\n");
  expect([...stored.values()]).toEqual(["adv_1"]);
  expect(open().key).toBe("adv_1");
});

test("a text that no header can carry is not sent", async () => {
  await expect(open().give("Schlüssel 1")).rejects.toThrow("letters");
});

test("requests wait from the refusal of a key to the next one", async () => {
  const access = open();
  access.refuse("", "this server needs a key");
  expect(access.problem).toBe("this server needs a key");
  const keys = [access.usable(), access.usable()];
  await expect(access.give("adv_9")).rejects.toThrow();
  await access.give("adv_2");
  expect(await Promise.all(keys)).toEqual(["adv_2", "adv_2"]);
  expect(access.problem).toBeNull();
});

test("an aborted request does not wait", async () => {
  const access = open();
  access.refuse("", "a key is needed");
  const stop = new AbortController();
  const key = access.usable(stop.signal);
  stop.abort();
  await expect(key).rejects.toMatchObject({ name: "AbortError" });
  await expect(access.usable(stop.signal)).rejects.toMatchObject({ name: "AbortError" });
});

test("the refusal of a key that was replaced meanwhile does not count", async () => {
  const access = open();
  await access.give("adv_1");
  access.refuse("", "late");
  expect(access.problem).toBeNull();
});

test("scopes are known after a response, and admin includes all", async () => {
  stored.set("adverb.key", "adv_1");
  const access = open();
  expect(access.may("author")).toBe(true); // the server decides
  await access.load();
  expect([access.may("pose"), access.may("author")]).toEqual([true, false]);
  await access.give("adv_2");
  expect(access.may("author")).toBe(true);
});

test("a stored key that is not valid any more leads to the prompt", async () => {
  stored.set("adverb.key", "adv_9");
  const access = open();
  await access.load();
  expect(access.problem).toBe("the key is unknown");
});

test("a forgotten key is removed from the tab", async () => {
  const access = open();
  await access.give("adv_1");
  let changes = 0;
  access.on(() => changes++);
  access.forget();
  expect([access.key, access.caller, stored.size, changes]).toEqual(["", null, 0, 1]);
});
