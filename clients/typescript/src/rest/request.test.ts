import { expect, test } from "vitest";
import { errorOf, retryMs } from "./request.js";

test("too many requests: the time to wait is in the text, and counts for the next request", () => {
  const body = '{"code": "too_many_requests", "detail": "this key may have 5 requests per second"}';
  const problem = errorOf(429, body, "3");
  expect(problem.detail).toBe("this key may have 5 requests per second: wait 3 s");
  expect(retryMs(problem, 1000)).toBe(3000);
  expect(retryMs(problem, 5000)).toBe(5000);
  expect(retryMs(new Error("other"), 1000)).toBe(1000);
});

test("a missing scope is named by the detail", () => {
  const body = '{"code": "missing_scope", "detail": "this needs a key with the scope \'author\'; yours has pose"}';
  expect(errorOf(403, body)).toMatchObject({ name: "NoAccess", status: 403, code: "missing_scope", retryMs: 0 });
  expect(errorOf(403, body).detail).toContain("'author'");
});
