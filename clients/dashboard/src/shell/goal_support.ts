/** Support of the goal by the examples: requested while the goal changes, since streams do not carry it. */

import type { Page } from "../app";
import { throttle } from "../panels/parts/disposables";
import { LatestRequest } from "../panels/parts/latest_request";
import type { PoseRequest, Verb, View } from "../types";
import { adverbValues } from "../verb";

const AFTER_MS = 80;

/** Returns a function for the support of the page's goal, 0–1; null while it is unknown. */
export function goalSupport(page: Page): () => number | null {
  let support: number | null = null;
  const latest = new LatestRequest<number>(
    async (key, signal) => {
      const [name, , request] = JSON.parse(key) as ReturnType<typeof requestOf>;
      return (await page.rest.pose(name, request, signal)).support;
    },
    (answer) => {
      support = "value" in answer ? answer.value : null;
    },
  );
  const requests = throttle(AFTER_MS, () => {
    const { verb, store } = page;
    if (!verb || verb.name !== store.view.verb || adverbValues(verb, store.view.goal).length === 0) return;
    latest.request(JSON.stringify(requestOf(verb, store.view)), false);
  });
  page.store.on(["goal", "method"], requests.schedule);
  page.on("verb", () => {
    support = null;
    latest.stop();
    requests.schedule();
  });
  return () => support;
}

/** Verb, version and request; one joint is enough. */
export function requestOf(verb: Verb, { goal, method }: View): readonly [string, number, PoseRequest] {
  const adverbs = Object.fromEntries(verb.adverbs.map(({ name }) => [name, goal[name] ?? 0]));
  const joints = verb.skeleton.names.slice(0, 1);
  return [verb.name, verb.version, { adverbs, joints, ...(method && { method }) }];
}
