import { expect, test } from "vitest";
import { arc } from "./vector.js";

test("half a turn between opposite directions is about +Z, or +Y for vectors along Z", () => {
  expect(arc([0, -2, 0], [0, 3, 0]).map(Math.abs)).toEqual([0, 0, 1, 0]);
  expect(arc([0, 0, 1], [0, 0, -1]).map(Math.abs)).toEqual([0, 1, 0, 0]);
  expect(arc([0, 0, 0], [0, 0, -1])).toEqual([0, 0, 0, 1]);
});
