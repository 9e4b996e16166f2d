import { execFileSync } from "node:child_process";
import { expect, test } from "vitest";
import { LANGUAGES, snippet, type Wanted } from "./snippets";

const wanted: Wanted = {
  server: "http://127.0.0.1:8000",
  verb: "reach",
  request: { adverbs: { x: -0.3, "it's": 1.2 }, fps: 30, method: "rbf" },
  keyed: false,
};

test("curl sends the request, with quotes that a shell undoes", () => {
  const text = snippet("curl", wanted).replace(/^curl/, "printf '%s\\n'");
  const words = execFileSync("sh", ["-c", text], { encoding: "utf8" }).trimEnd().split("\n");
  expect(words).toContain("http://127.0.0.1:8000/v1/verbs/reach/sequence");
  const body = JSON.parse(words[words.indexOf("-d") + 1] ?? "");
  expect(body).toEqual({ ...wanted.request, mannequin: true });
  expect(words.at(-1)).toBe("reach.glb");
});

test("Python names the options", () => {
  const text = snippet("Python", wanted);
  expect(text).toContain('client.sequence("reach", {"x":-0.3,"it\'s":1.2}, fps=30, method="rbf")');
  expect(text).not.toContain("import os");
});

test("JavaScript runs as it is", async () => {
  const requests: [string, RequestInit][] = [];
  const fetch = async (url: string, init: RequestInit) => {
    requests.push([url, init]);
    return { json: async () => ({ frames: 31, duration: 1 }) };
  };
  const lines: unknown[][] = [];
  const run = new Function("fetch", "console", `return (async () => { ${snippet("JavaScript", wanted)} })()`);
  await run(fetch, { log: (...values: unknown[]) => lines.push(values) });
  expect(requests[0]?.[0]).toBe("http://127.0.0.1:8000/v1/verbs/reach/sequence");
  expect(JSON.parse(String(requests[0]?.[1].body))).toEqual(wanted.request);
  expect(lines).toEqual([[31, 1]]);
});

test("C# has the goal and the options of the client", () => {
  const text = snippet("C#", wanted);
  expect(text).toContain('new AdverbClient("http://127.0.0.1:8000")');
  expect(text).toContain('{ { "x", -0.3 }, { "it\'s", 1.2 } };');
  expect(text).toContain('SequenceAsync("reach", goal, fps: 30, options: new PoseOptions { Method = "rbf" });');
});

test.each(LANGUAGES)("%s reads a key from the environment, where the server needs one", (language) => {
  expect(snippet(language, { ...wanted, keyed: true })).toContain("ADVERB_KEY");
  expect(snippet(language, wanted)).not.toContain("ADVERB_KEY");
});
