/** Entry point: creates the parts of the page and connects them. */

import { createRest } from "./api/rest";
import { Page } from "./app";
import { publish } from "./published_state";
import { createStage } from "./scene/stage";
import { h } from "./shell/dom";
import { header } from "./shell/header";
import { bindKeys, shortcutDialog } from "./shell/keys";
import { notices, overlay } from "./shell/notices";
import { panel } from "./shell/panel";
import { readout } from "./shell/readout";
import { transport } from "./shell/transport";
import { verbTab } from "./shell/verb_tab";
import { createStore, readView, syncAddress } from "./store";
import { ThemeController } from "./theme";
import type { Drawn, Stage, View } from "./types";
import { openWorker } from "./wire/client";

const CAMERA_DIGITS = 3;

function start(): void {
  const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const link = readView(location.hash);
  const store = createStore(reducedMotion && !location.hash.includes("playing=") ? { ...link, playing: false } : link);
  syncAddress(store);
  const colours = new ThemeController(store, document.documentElement);
  const page = new Page(store, createRest(), openWorker(), reducedMotion);
  const canvas = h("div", { className: "stage" });
  const scene = h("main", { className: "scene", "aria-label": "Scene" }, canvas);
  const keys = shortcutDialog();
  const help = () => (keys.open ? keys.close() : keys.showModal());
  let stage: Stage | null = null;
  const reset = () => {
    store.change({ camera: null });
    stage?.resetView();
  };
  const bar = transport(page);
  scene.append(
    readout(page, () => (stage ? goalDistance(stage.drawn) : null)),
    overlay(page, scene),
    notices(page),
    bar,
  );
  document.body.append(header(page, help), scene, panel(page, verbTab(page, reset)), keys);
  bindKeys(page, reset, help);
  try {
    stage = createStage(canvas);
  } catch (err) {
    page.notify(err instanceof Error ? err.message : String(err), "error");
  }
  if (stage) {
    join(page, stage, colours);
    keepClear(stage, scene, bar);
  }
  publish(page, stage);
  page.start(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/v1/stream`);
  const frame = (ms: number) => {
    page.frame(ms);
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
  addEventListener("pagehide", (event) => event.persisted || page.stop());
}

/** Distance between effector and goal in the last frame, m; null if one of them has no position. */
function goalDistance({ effector, goal }: Drawn): number | null {
  return effector && goal ? Math.hypot(...effector.map((value, k) => value - (goal[k] as number))) : null;
}

/** Keep the figure above the transport bar at every window size. */
function keepClear(stage: Stage, scene: HTMLElement, bar: HTMLElement): void {
  const fit = () => stage.setInset(0, scene.getBoundingClientRect().bottom - bar.getBoundingClientRect().top);
  const sizes = new ResizeObserver(fit);
  sizes.observe(scene);
  sizes.observe(bar);
}

/** Bind view to stage and stage to view. */
function join(page: Page, stage: Stage, colours: ThemeController): void {
  const { store } = page;
  const bind = (keys: (keyof View)[], then: (view: View) => void) => {
    then(store.view);
    store.on(keys, then);
  };
  bind(["hull", "examples", "pseudo"], ({ hull, examples, pseudo }) => stage.setMarks({ hull, examples, pseudo }));
  bind(["follow"], ({ follow }) => stage.setFollow(follow));
  bind(["detail"], ({ detail }) => stage.setDetail(detail));
  bind(["goal"], ({ goal }) => stage.setGoal(goal));
  colours.on((isDark) => stage.setTheme(isDark));
  let moved = "";
  bind(["camera"], ({ camera }) => {
    if (JSON.stringify(camera) !== moved) stage.setCamera(camera);
  });
  page.on("verb", (verb) => {
    stage.setVerb(verb);
    stage.setGoal(store.view.goal);
    stage.setCamera(store.view.camera);
  });
  page.on("picture", ({ role, picture }) => {
    stage.show(role, picture);
    if (picture) document.documentElement.dataset.ready ??= "true";
  });
  stage.onGoal = (goal, done) => page.setGoal(goal, done);
  stage.onExample = (adverbs) => page.setGoal(adverbs, true);
  stage.onCamera = (camera) => {
    const rounded = camera.map((value) => Number(value.toFixed(CAMERA_DIGITS)));
    moved = JSON.stringify(rounded);
    store.change({ camera: rounded });
  };
}

start();
