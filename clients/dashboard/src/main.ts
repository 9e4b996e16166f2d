/** The page: parts are made here, and joined; the rest of it knows no more than its neighbours. */

import { createRest } from "./api/rest";
import { Page } from "./app";
import { publish } from "./published_state";
import { createStage } from "./scene/stage";
import { h } from "./shell/dom";
import { header } from "./shell/header";
import { keyList, listen } from "./shell/keys";
import { notices, veil } from "./shell/notices";
import { panel } from "./shell/panel";
import { readout } from "./shell/readout";
import { transport } from "./shell/transport";
import { verbTab } from "./shell/verb_tab";
import { createStore, readView, syncAddress } from "./store";
import { Colours } from "./theme";
import type { Stage, View } from "./types";
import { openWorker } from "./wire/client";

const CAMERA_DIGITS = 3;

function start(): void {
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const link = readView(location.hash);
  const store = createStore(still && !location.hash.includes("playing=") ? { ...link, playing: false } : link);
  syncAddress(store);
  const colours = new Colours(store, document.documentElement);
  const page = new Page(store, createRest(), openWorker(), still);
  const canvas = h("div", { className: "stage" });
  const scene = h("main", { className: "scene", "aria-label": "Scene" }, canvas);
  const keys = keyList();
  const help = () => (keys.open ? keys.close() : keys.showModal());
  let stage: Stage | null = null;
  const reset = () => {
    store.change({ camera: null });
    stage?.resetView();
  };
  const bar = transport(page);
  scene.append(readout(page), veil(page, scene), notices(page), bar);
  document.body.append(header(page, help), scene, panel(page, verbTab(page, reset)), keys);
  listen(page, reset, help);
  try {
    stage = createStage(canvas);
  } catch (err) {
    page.say(err instanceof Error ? err.message : String(err), "error");
  }
  if (stage) {
    join(page, stage, colours);
    makeRoom(stage, scene, bar);
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

/** The figure is shown above the transport bar, whatever the window's size. */
function makeRoom(stage: Stage, scene: HTMLElement, bar: HTMLElement): void {
  const fit = () => stage.setAside(0, scene.getBoundingClientRect().bottom - bar.getBoundingClientRect().top);
  const sizes = new ResizeObserver(fit);
  sizes.observe(scene);
  sizes.observe(bar);
}

/** What the view says goes to the stage, and what is done on the stage goes to the view. */
function join(page: Page, stage: Stage, colours: Colours): void {
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
  page.on("picture", ({ side, picture }) => {
    stage.show(side, picture);
    if (picture) document.documentElement.dataset.ready ??= "true";
  });
  stage.onGoal = (goal, done) => page.aim(goal, done);
  stage.onExample = (adverbs) => page.aim(adverbs, true);
  stage.onCamera = (camera) => {
    const rounded = camera.map((value) => Number(value.toFixed(CAMERA_DIGITS)));
    moved = JSON.stringify(rounded);
    store.change({ camera: rounded });
  };
}

start();
