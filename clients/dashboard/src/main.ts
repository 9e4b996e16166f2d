/** Entry point: creates the parts of the page and connects them. */

import { Access, tabStorage } from "./access/access";
import { keyPrompt } from "./access/prompt";
import { callerOf, Rest } from "./api/rest";
import { Page } from "./app";
import { Inclines } from "./incline";
import { motionExtent } from "./motion_extent";
import { OwnFigure } from "./own/own_figure";
import { publish } from "./published_state";
import { createStage } from "./scene/stage";
import { h } from "./shell/dom";
import { driveHud } from "./shell/drive_hud";
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
/** Scene width below which the readout covers the figure. */
const NARROW_PX = 600;

function start(): void {
  const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const link = readView(location.hash);
  const store = createStore(reducedMotion && !location.hash.includes("playing=") ? { ...link, playing: false } : link);
  syncAddress(store);
  const colours = new ThemeController(store, document.documentElement);
  const access = new Access(tabStorage(), callerOf);
  const page = new Page(
    store,
    new Rest("", access, ({ code }) => code === "unknown_verb" && void page.refresh()),
    access,
    openWorker(),
    reducedMotion,
  );
  const own = new OwnFigure(page);
  const canvas = h("div", { className: "stage" });
  const scene = h("main", { className: "scene", "aria-label": "Scene", tabIndex: -1 }, canvas);
  const keys = shortcutDialog();
  const help = () => (keys.open ? keys.close() : keys.showModal());
  let stage: Stage | null = null;
  const reset = () => {
    store.change({ camera: null });
    stage?.resetView();
  };
  const bar = transport(page);
  const find = h("button", { type: "button", className: "find-figure", hidden: true, onclick: reset }, "Find figure");
  const values = readout(
    page,
    () => (stage ? goalDistance(stage.drawn) : null),
    () => stage?.drawn ?? null,
  );
  const hud = driveHud(page, () => stage?.drawn ?? null);
  scene.append(values, hud, overlay(page, scene), notices(page), find, bar);
  document.body.append(
    header(page, help),
    scene,
    panel(page, verbTab(page, own, reset)),
    draftPart(page, colours),
    keys,
  );
  document.body.append(keyPrompt(access));
  bindKeys(page, reset, help);
  page.drive.keyboard.listen(window);
  try {
    stage = createStage(canvas, store.view.detail);
  } catch (err) {
    page.notify(err instanceof Error ? err.message : String(err), "error");
  }
  if (stage) {
    join(page, stage, colours, find);
    keepClear(stage, scene, bar, values);
  }
  takeFigures(scene, own);
  own.start(stage);
  publish(page, stage, own);
  page.start(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/v1/stream`);
  addEventListener("focus", () => void page.refresh());
  const frame = (ms: number) => {
    page.frame(ms);
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
  addEventListener("pagehide", (event) => event.persisted || page.stop());
}

/** A GLB or VRM file that is dropped on the scene becomes the figure. */
function takeFigures(scene: HTMLElement, own: OwnFigure): void {
  scene.addEventListener("dragover", (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    scene.classList.add("over");
  });
  scene.addEventListener("dragleave", () => scene.classList.remove("over"));
  scene.addEventListener("drop", (event) => {
    event.preventDefault();
    scene.classList.remove("over");
    const file = [...(event.dataTransfer?.files ?? [])].find(OwnFigure.accepts);
    if (file) void own.take(file);
    else own.refuse();
  });
}

/** The open draft, loaded on demand; covers scene and panel. */
function draftPart(page: Page, colours: ThemeController): HTMLElement {
  const host = h("main", { className: "draft", "aria-label": "Draft" });
  let close = () => {};
  const show = async () => {
    const { draft } = page.store.view;
    close();
    close = () => {};
    document.documentElement.dataset.draft = draft ? "yes" : "no";
    if (!draft) return;
    const { mount } = await import("./drafts/view");
    if (draft === page.store.view.draft) close = mount(host, page, colours);
  };
  page.store.on(["draft"], () => void show());
  void show();
  return host;
}

/** Distance between effector and goal in the last frame, m; null if one of them has no position. */
function goalDistance({ effector, goal }: Drawn): number | null {
  return effector && goal ? Math.hypot(...effector.map((value, k) => value - (goal[k] as number))) : null;
}

/** Keep the figure above the transport bar, and on narrow windows below the readout. */
function keepClear(stage: Stage, scene: HTMLElement, bar: HTMLElement, values: HTMLElement): void {
  const fit = () => {
    const { top, bottom, width } = scene.getBoundingClientRect();
    const isShown = bar.getClientRects().length > 0; // not in drive mode
    const covered = width < NARROW_PX && isShown ? values.getBoundingClientRect().bottom - top : 0;
    stage.setInset(Math.max(covered, 0), isShown ? bottom - bar.getBoundingClientRect().top : 0);
  };
  const sizes = new ResizeObserver(fit);
  for (const element of [scene, bar, values]) sizes.observe(element);
}

/** Bind view to stage and stage to view. */
function join(page: Page, stage: Stage, colours: ThemeController, find: HTMLElement): void {
  const { store } = page;
  const bind = (keys: (keyof View)[], then: (view: View) => void) => {
    then(store.view);
    store.on(keys, then);
  };
  bind(["hull", "examples", "pseudo"], ({ hull, examples, pseudo }) => stage.setMarks({ hull, examples, pseudo }));
  bind(["follow"], ({ follow }) => stage.setFollow(follow));
  bind(["detail"], ({ detail }) => stage.setDetail(detail));
  const inclines = new Inclines(page.rest, (incline) => stage.setIncline(incline));
  bind(["goal"], ({ goal }) => {
    stage.setGoal(goal);
    inclines.move(goal);
  });
  const drive = () => {
    document.documentElement.dataset.drive = page.drive.active ? "yes" : "no";
    stage.setDrive(page.drive.active);
  };
  bind(["drive", "verb", "draft"], drive);
  colours.on((isDark) => stage.setTheme(isDark));
  let moved = "";
  bind(["camera"], ({ camera }) => {
    if (JSON.stringify(camera) !== moved) stage.setCamera(camera);
  });
  page.on("verb", (verb) => {
    stage.setVerb(verb);
    motionExtent(page.rest, verb).then(
      (points) => page.verb === verb && stage.setExtent(points),
      () => {}, // the frame of the rest pose remains
    );
    inclines.select(verb, store.view.goal).catch(() => {}); // level ground remains
    stage.setGoal(store.view.goal);
    stage.setCamera(store.view.camera);
    drive();
  });
  page.on("picture", ({ role, picture }) => {
    stage.show(role, picture);
    if (role === "main" && store.view.crowd > 1) page.moveCrowd(stage.crowd, performance.now());
    if (picture) document.documentElement.dataset.ready ??= "true";
  });
  stage.onGoal = (goal, done) => page.setGoal(goal, done);
  stage.onExample = (adverbs) => page.setGoal(adverbs, true);
  stage.onOffscreen = (offscreen) => {
    find.hidden = !offscreen;
  };
  stage.onCamera = (camera) => {
    const rounded = camera.map((value) => Number(value.toFixed(CAMERA_DIGITS)));
    moved = JSON.stringify(rounded);
    store.change({ camera: rounded });
  };
}

start();
