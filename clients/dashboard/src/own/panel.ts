/** Part of the verb tab: the user's own figure, its two distances, and a table to correct the mapping. */

import type { Page } from "../app";
import { choice, h } from "../shell/dom";
import { OwnFigure } from "./own_figure";

const UPDATE_MS = 250;

export function ownFigurePart(page: Page, own: OwnFigure): HTMLElement {
  const input = h("input", {
    type: "file",
    accept: ".glb,.vrm",
    hidden: true,
    onchange: () => {
      const [file] = input.files ?? [];
      if (OwnFigure.accepts(file)) void own.take(file);
      input.value = "";
    },
  });
  const pick = h("button", { type: "button", onclick: () => input.click() }, "Choose a GLB or VRM file");
  const hint = h(
    "p",
    { className: "quiet" },
    "Or drop it on the scene. It is mapped by the names of its bones, and stays in this browser.",
  );
  const name = h("strong", { className: "figure-name" });
  const remove = h("button", { type: "button", onclick: () => own.remove() }, "Remove");
  const goal = choice(
    "Effector's goal",
    [
      ["scaled", "scaled to its size"],
      ["world", "as for the mannequin"],
    ],
    (value) => page.store.change({ figureGoal: value === "world" ? "world" : "scaled" }),
  );
  const figures = h("dl", { className: "figure-distances" });
  const table = h("div", { className: "figure-joints" });
  const count = h("summary", {});
  const details = h("details", {}, count, table);
  const shown = h(
    "div",
    { className: "own-figure", hidden: true },
    h("div", { className: "figure-head" }, name, remove),
    figures,
    goal.element,
    details,
  );
  const show = () => {
    const { model } = own;
    shown.hidden = !model;
    pick.textContent = model ? "Choose another file" : "Choose a GLB or VRM file";
    hint.hidden = Boolean(model);
    if (!model) return;
    name.textContent = page.store.view.figure;
    goal.select.value = page.store.view.figureGoal;
    count.textContent = `${model.mapper?.rows.length ?? 0} of ${model.names.length} joints move`;
    table.replaceChildren(...jointRows(page, own));
  };
  const update = () => showDistances(page, own, figures);
  own.onChange = () => {
    show();
    update();
  };
  page.store.on(["figureGoal"], show);
  setInterval(() => own.model && document.visibilityState === "visible" && update(), UPDATE_MS);
  show();
  return h("div", {}, shown, h("div", { className: "actions" }, input, pick), hint);
}

/** Effector and feet of the displayed pose; scaled lengths. */
function showDistances(page: Page, own: OwnFigure, list: HTMLElement): void {
  const { mapper } = own.model ?? {};
  const row = (label: string, value: number | null, title: string) =>
    value === null ? [] : [h("dt", { title }, label), h("dd", {}, `${(1000 * value).toFixed(1)} mm`)];
  const { effector = null, feet = null } = mapper?.figures ?? {};
  const atGoal = isAtGoal(page);
  list.replaceChildren(
    h("dt", {}, "Lengths"),
    h("dd", {}, mapper ? `× ${mapper.scale.toFixed(2)}` : "–"),
    ...row("Standing feet", feet, "Distance of standing feet from where they belong"),
    ...row(atGoal ? "Effector" : "Effector, on its way", effector, "Distance of the effector from its goal"),
  );
}

/** Whether the displayed pose is that at the keytime of the goal. */
function isAtGoal({ verb, shown }: Page): boolean {
  const phase = verb?.keytime_phases[verb.keytime_names.indexOf(verb.measure.keytime ?? "")];
  return phase !== undefined && Math.abs((shown.main?.phase ?? 0) - phase) < 0.01;
}

/** A select for each joint of the verb. */
function jointRows(page: Page, own: OwnFigure): HTMLElement[] {
  const { model } = own;
  const names = page.verb?.skeleton.names ?? [];
  const rows = model?.mapper?.rows ?? [];
  const corrected = Object.keys(own.joints).length > 0;
  const options = ["", ...(model?.names ?? [])].map((name) => [name, name || "–"] as const);
  const selects = names.map((joint, k) => {
    const moved = rows.find(({ first, share, bone }) => first === k && (share === 0 || bone !== ""));
    const value = own.joints[joint] ?? model?.names[moved?.target ?? -1] ?? "";
    const { element, select } = choice(joint, options, (target) => own.correct(joint, target));
    select.value = value;
    select.ariaLabel = joint;
    element.classList.toggle("corrected", joint in own.joints);
    return element;
  });
  const reset = h("button", { type: "button", hidden: !corrected, onclick: () => own.reset() }, "Match by names again");
  return [...selects, reset];
}
