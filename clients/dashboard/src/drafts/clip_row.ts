/** Row of a clip: name, time line, exclusion; for the selected clip also keytimes, values, mends and warnings. */

import { h } from "../shell/dom";
import { adverbUnit, countText, digits } from "../units";
import { ClipLine, spanOf } from "./clip_line";
import { SET } from "./edits";
import { confidenceText, moved } from "./timeline";
import type { Clip, ClipEdit, Draft } from "./types";

/** Leave-one-out error above this multiple of the mean is marked. */
const POOR = 2;
/** Meaning of the left-out error, for a tooltip. */
export const LEFT_OUT = "Mean angle between the joints of a clip and their prediction from the other clips";
/** Mends that are offered for clips without a fault. */
const OPTIONAL = ["idle", "start", "mirror"];

export interface RowActions {
  select(name: string): void;
  /** A keytime of a clip was grabbed: the scene shows its instant. */
  keytime(name: string, k: number): void;
  /** A drag of a keytime began or ended. */
  dragged(on: boolean): void;
  edit(name: string, edit: ClipEdit): void;
}

export class ClipRow {
  readonly element = h("li", { className: "clip" });
  readonly line: ClipLine;
  readonly #name: HTMLButtonElement;
  readonly #about = h("span", { className: "quiet clip-about" });
  readonly #chips = h("span", { className: "clip-chips" });
  readonly #include: HTMLInputElement;
  readonly #reason = h("p", { className: "clip-reason" });
  readonly #more = h("div", { className: "clip-more" });
  #shown = "";

  constructor(
    private readonly name: string,
    private readonly actions: RowActions,
  ) {
    this.line = new ClipLine({
      grabbed: (k) => {
        actions.select(name);
        actions.keytime(name, k);
      },
      moved: (keytimes) => actions.edit(name, { keytimes }),
      dragged: (on) => actions.dragged(on),
    });
    this.#name = h("button", { type: "button", className: "clip-name", onclick: () => actions.select(name) }, name);
    this.#include = h("input", {
      type: "checkbox",
      "aria-label": `Use ${name}`,
      onchange: () => actions.edit(name, { excluded: !this.#include.checked }),
    });
    const use = h("label", { className: "toggle" }, this.#include, h("span", { "aria-hidden": "true" }, "Use"));
    this.element.append(
      h("div", { className: "clip-head" }, this.#name, this.#about, this.#chips, use),
      this.line.element,
      this.#reason,
      this.#more,
    );
  }

  show(clip: Clip, draft: Draft, selected: boolean): void {
    this.element.dataset.state = clip.readable ? (clip.excluded ? "excluded" : "used") : "unreadable";
    this.element.classList.toggle("selected", selected);
    this.#name.ariaExpanded = String(selected);
    this.#about.textContent = clip.duration === null ? "" : `${clip.duration.toFixed(2)} s`;
    this.#include.checked = !clip.excluded;
    this.#include.disabled = !clip.readable;
    this.line.element.hidden = !clip.keytimes;
    this.line.show(clip, draft.keytime_names, draft.effector_keytime_index);
    this.#reason.textContent = clip.problem || (clip.excluded ? clip.reason : "");
    this.#reason.hidden = !this.#reason.textContent;
    this.#chips.replaceChildren(...chipsOf(clip, draft).map((text) => h("span", { className: "badge" }, text)));
    this.#more.hidden = !selected || !clip.readable;
    if (!this.#more.hidden) this.#detail(clip, draft);
  }

  /** Contents of the selected row; kept while only a keytime moves, so that its input keeps the focus. */
  #detail(clip: Clip, draft: Draft): void {
    const key = JSON.stringify([clip, draft.keytime_names, draft.adverbs]);
    if (key === this.#shown) return;
    this.#shown = key;
    const focused = ([...this.#more.querySelectorAll("input")] as Element[]).indexOf(
      document.activeElement ?? document.body,
    );
    this.#more.replaceChildren(
      keytimeTable(clip, draft, (edit) => this.actions.edit(this.name, edit)),
      values(clip, draft, (edit) => this.actions.edit(this.name, edit)),
      ...mends(clip, (edit) => this.actions.edit(this.name, edit)),
      ...clip.warnings.map((text) => h("p", { className: "dot-line", "data-state": "warn" }, text)),
    );
    if (focused >= 0) this.#more.querySelectorAll("input")[focused]?.focus();
  }
}

type Edit = (edit: ClipEdit) => void;

/** Remarks that are shown beside the name. */
function chipsOf(clip: Clip, { left_out_mean }: Draft): string[] {
  if (!clip.readable) return ["not readable"];
  const unsure = !clip.set && clip.confidence?.some((each) => each < 0.5);
  const poor =
    !clip.excluded && clip.left_out !== null && clip.left_out > POOR * (left_out_mean ?? Number.POSITIVE_INFINITY);
  const mended = clip.mends.filter(({ apply }) => apply).length;
  const found = clip.mends.filter(({ apply, kind }) => !apply && !OPTIONAL.includes(kind)).length;
  return [
    unsure && "check keytimes",
    poor && "predicted badly",
    mended > 0 && countText(mended, "mend"),
    found > 0 && countText(found, "fault"),
  ].filter((text) => text !== false && text !== undefined);
}

function keytimeTable(clip: Clip, draft: Draft, edit: Edit): HTMLElement {
  const rows = (clip.keytimes ?? []).map((at, k) => {
    const name = draft.keytime_names[k] ?? `keytime ${k + 1}`;
    const input = h("input", {
      type: "number",
      step: String(1 / (clip.fps ?? 30)),
      value: at.toFixed(3),
      "aria-label": `${name}, s`,
      onchange: () => {
        if (Number.isFinite(input.valueAsNumber))
          edit({ keytimes: moved(spanOf(clip), clip.keytimes ?? [], k, input.valueAsNumber) });
      },
    });
    const evidence = clip.evidence?.[k];
    const how =
      evidence === SET ? "set by hand" : [confidenceText(clip.confidence?.[k]), evidence].filter(Boolean).join(", ");
    return h(
      "div",
      { className: "keytime-row" },
      h("span", {}, name),
      input,
      h("span", { className: "unit" }, "s"),
      h("small", {}, how),
    );
  });
  const reset = h("button", { type: "button", onclick: () => edit({ keytimes: null }) }, "As proposed");
  return h("div", { className: "keytime-rows" }, ...rows, clip.set && reset);
}

/** Measured values as text, style adverbs as inputs. */
function values(clip: Clip, draft: Draft, edit: Edit): HTMLElement {
  const cells = draft.adverbs.map(({ name, unit, style }) => {
    const { text, factor } = adverbUnit(unit);
    const value = clip.adverbs?.[name];
    const input = h("input", {
      type: "number",
      step: "any",
      value: String(value ?? 0),
      "aria-label": name,
      onchange: () => Number.isFinite(input.valueAsNumber) && edit({ adverbs: { [name]: input.valueAsNumber } }),
    });
    const shown = value === undefined ? "–" : `${digits(value * factor)} ${text}`;
    return h("div", {}, h("dt", {}, name), h("dd", {}, style ? input : shown));
  });
  const left = clip.left_out === null ? "–" : `${clip.left_out.toFixed(1)}°`;
  return h(
    "dl",
    { className: "clip-values" },
    ...cells,
    h("div", { title: LEFT_OUT }, h("dt", {}, "left-out error"), h("dd", {}, left)),
  );
}

function mends(clip: Clip, edit: Edit): HTMLElement[] {
  return clip.mends.map(({ index, kind, text, apply }) => {
    const box = h("input", {
      type: "checkbox",
      checked: apply,
      onchange: () => edit({ mends: [{ index, apply: box.checked }] }),
    });
    return h(
      "label",
      { className: "toggle mend" },
      box,
      h("span", {}, h("strong", {}, apply ? `Mended ${kind}` : `Mend ${kind}`), h("small", {}, text)),
    );
  });
}
