/** Maps of error, smoothness and support over a slice of adverb space, one per method, with a common colour scale. */

import { textOf } from "../../app";
import { choice, h, setOptions, toggle } from "../../shell/dom";
import { methodLabel } from "../../shell/header";
import type { App, Verb, View } from "../../types";
import { adverbUnit, digits, errorUnit, kappa, shareText, type Unit } from "../../units";
import { gradient, linearScale, logScale, type Scale, SHARES } from "./colours";
import { type Disposables, throttle } from "./disposables";
import { LatestRequest } from "./latest_request";
import { type Picture, type Place, QualityMap } from "./quality_map";
import { lookUp, NODES, near, type Quality, qualityPath, type Slice, sliceOf } from "./slice";
import { type SliderRow, sliceSliders } from "./slice_sliders";

const AFTER_MS = 80;
/** Smallest upper limit of the error scale, in the measure's unit. */
const FINEST = 0.001;

/** One map: a method of the current version or of another version. */
interface Cell {
  method: string;
  version: number | null;
  map: QualityMap;
  source: LatestRequest<Quality>;
  quality: Quality | null;
  problem: string;
}

export class QualityMaps {
  readonly element: HTMLElement;
  private readonly across;
  private readonly up;
  private readonly kinds = h("div", { className: "kinds", role: "group", "aria-label": "Map" });
  private readonly follow;
  private readonly methods = h("div", { className: "chips", role: "group", "aria-label": "Methods" });
  private readonly unavailable = h("small", { className: "unavailable" });
  private readonly fixed = h("div", { className: "adverbs" });
  private readonly grid = h("div", { className: "maps" });
  private readonly bar = h("div", { className: "ramp", style: `background: ${gradient()}` });
  private readonly ticks = h("div", { className: "ramp-ticks" });
  private readonly caption = h("small", {});
  private readonly status = h("output", { className: "pointed", "aria-live": "off" });
  private rows: SliderRow[] = [];
  private cells: Cell[] = [];
  private slice: Slice | null = null;
  private pointed: Place | null = null;
  private shape = "";
  private readonly mapRequests = throttle(AFTER_MS, () => this.requestMaps());
  private frame = 0;

  constructor(
    private readonly app: App,
    disposables: Disposables,
  ) {
    const { store } = app;
    this.across = choice("X axis", [], (name) => this.setAxes({ across: name }));
    this.up = choice("Y axis", [], (name) => this.setAxes({ up: name }));
    for (const [map, text] of MAP_KINDS) {
      const onclick = () => store.change({ map });
      this.kinds.append(h("button", { type: "button", "data-map": map, onclick }, text));
    }
    this.follow = toggle("Slice through the goal", (on) => store.change({ slice: on ? null : store.view.goal }));
    this.element = this.layOut();
    disposables.add(
      app.on("verb", () => this.show()),
      store.on(["across", "up"], () => this.show()),
      store.on(["goal", "slice"], () => this.updateSlice()),
      store.on(["compare", "maps"], () => this.choose(this.chosen)),
      store.on(["map", "pseudo"], () => this.draw()),
      () => this.end(),
    );
    this.show();
  }

  private layOut(): HTMLElement {
    const axes = h("div", { className: "axes" }, this.across.element, this.up.element);
    const legend = h("div", { className: "legend" }, this.caption, this.bar, this.ticks);
    const sliceRow = h("div", { className: "slice" }, this.follow.element);
    return h(
      "section",
      { className: "quality-maps", "aria-label": "QualityMaps" },
      ...[this.kinds, axes, this.methods, this.grid, this.status, legend, sliceRow, this.fixed, this.unavailable],
    );
  }

  private end(): void {
    this.mapRequests.stop();
    cancelAnimationFrame(this.frame);
    for (const cell of this.cells) drop(cell);
  }

  private get verb(): Verb | null {
    const { verb, store } = this.app;
    return verb?.name === store.view.verb ? verb : null;
  }

  private get chosen(): readonly string[] {
    const { verb } = this;
    if (!verb) return [];
    const usable = this.app.store.view.maps.filter((method) => verb.methods.includes(method));
    if (usable.length > 0) return usable;
    const shown = ["rbf", "refined", verb.default_method].filter((method) => verb.methods.includes(method));
    return [...new Set(shown)];
  }

  /** Rebuild for another verb, version or pair of axes. */
  private show(): void {
    const { verb } = this;
    this.element.hidden = verb === null;
    if (!verb) return;
    const names = verb.adverbs.map(({ name }) => [name, name] as const);
    for (const { select } of [this.across, this.up]) setOptions(select, names);
    this.slice = sliceOf(verb, this.app.store.view, this.at());
    if (!this.slice) return;
    this.across.select.value = this.slice.across.name;
    this.up.select.value = this.slice.up.name;
    const line = this.slice.across === this.slice.up;
    this.up.element.hidden = line;
    this.grid.classList.toggle("lines", line);
    this.follow.element.hidden = this.slice.fixed.length === 0;
    this.follow.box.checked = this.app.store.view.slice === null;
    this.rows = sliceSliders(this.slice, (name, value) => this.drag(name, value));
    this.fixed.replaceChildren(...this.rows.map(({ element }) => element));
    this.unavailable.textContent = unavailableText(verb);
    this.choose(this.chosen);
  }

  /** Values of the fixed adverbs: from the goal, or from the slice sliders. */
  private at(): Readonly<Record<string, number>> {
    const { goal, slice } = this.app.store.view;
    return { ...goal, ...slice };
  }

  private setAxes(axes: { across?: string; up?: string }): void {
    const { slice } = this;
    if (!slice) return;
    const next = { across: slice.across.name, up: slice.up.name, ...axes };
    if (next.across === next.up) Object.assign(next, { across: slice.up.name, up: slice.across.name });
    this.app.store.change(next);
  }

  private drag(name: string, value: number): void {
    const { store } = this.app;
    const { goal, slice } = store.view;
    store.change(slice ? { slice: { ...slice, [name]: value } } : { goal: { ...goal, [name]: value } });
  }

  private updateSlice(): void {
    const { verb } = this;
    if (!verb) return;
    this.slice = sliceOf(verb, this.app.store.view, this.at());
    if (!this.slice) return;
    this.follow.box.checked = this.app.store.view.slice === null;
    this.slice.fixed.forEach(([, value], k) => {
      this.rows[k]?.show(value);
    });
    this.mapRequests.schedule();
    this.draw();
  }

  /** Show maps of these methods; a compared version adds a second map per method. */
  private choose(methods: readonly string[]): void {
    const { verb } = this;
    if (!verb) return;
    this.methods.replaceChildren(...verb.methods.map((method) => this.chip(method, methods)));
    const { compare } = this.app.store.view;
    const others = compare.kind === "version" && compare.version !== verb.version ? [compare.version] : [];
    const versions = [null, ...others];
    const selected = methods.flatMap((method) => versions.map((version) => ({ method, version })));
    const before = this.cells;
    this.cells = selected.map(({ method, version }) => {
      const known = before.find((cell) => cell.method === method && cell.version === version);
      return known ?? this.cell(method, version);
    });
    for (const cell of before) if (!this.cells.includes(cell)) drop(cell);
    this.grid.replaceChildren(...this.cells.map(({ map }) => map.element));
    this.requestMaps();
    this.draw();
  }

  private chip(method: string, chosen: readonly string[]): HTMLElement {
    const on = chosen.includes(method);
    const others = on ? chosen.filter((each) => each !== method) : [...chosen, method];
    const ordered = this.verb?.methods.filter((each) => others.includes(each)) ?? [];
    const onclick = () => ordered.length > 0 && this.app.store.change({ maps: ordered });
    return h("button", { type: "button", className: "chip", "aria-pressed": String(on), onclick }, methodLabel(method));
  }

  private cell(method: string, version: number | null): Cell {
    const map = new QualityMap({ point: (place) => this.point(place), choose: (place) => this.setGoal(place) });
    const source = new LatestRequest<Quality>(
      (path, signal) => this.app.rest.json(path, { signal }),
      (answer) => {
        cell.problem = "problem" in answer ? textOf(answer.problem) : "";
        cell.quality = "value" in answer ? answer.value : null;
        this.draw();
      },
    );
    const cell: Cell = { method, version, map, source, quality: null, problem: "" };
    return cell;
  }

  private requestMaps(): void {
    const { verb, slice } = this;
    if (!verb || !slice) return;
    const shape = JSON.stringify([verb.name, verb.version, slice.across.name, slice.up.name]);
    const other = shape !== this.shape;
    this.shape = shape;
    for (const cell of this.cells) {
      if (other) cell.quality = null;
      cell.source.request(qualityPath(verb.name, slice, cell.method, cell.version ?? verb.version), other);
    }
    this.draw();
  }

  private point(place: Place | null): void {
    this.pointed = place;
    this.draw();
  }

  private setGoal([across, up]: Place): void {
    const { slice, app } = this;
    if (!slice) return;
    const fixed = slice.fixed.map(([{ name }, value]) => [name, value]);
    const values = [...fixed, [slice.across.name, across], ...(slice.up === slice.across ? [] : [[slice.up.name, up]])];
    const rounded = values.map(([name, value]) => [name, Number(Number(value).toFixed(4))]);
    app.store.change({ goal: { ...app.store.view.goal, ...Object.fromEntries(rounded) } });
  }

  /** Redraw at most once per animation frame. */
  private draw(): void {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.paint());
  }

  private paint(): void {
    const { verb, slice } = this;
    const { view } = this.app.store;
    if (!verb || !slice) return;
    for (const button of this.kinds.children) button.ariaPressed = String(button.getAttribute("data-map") === view.map);
    const known = this.cells.flatMap(({ quality }) => quality ?? []);
    const most = Math.max(FINEST, ...known.map(({ error_max }) => error_max ?? 0));
    const unit = errorUnit(verb.measure.unit, most);
    const scale = scaleOf(view.map, known, most, unit);
    this.legend(view.map, scale, unit);
    const none = view.map === "error" && verb.measure.kind === "none";
    this.caption.parentElement?.toggleAttribute("hidden", none);
    const common = this.common(verb, slice, view, scale);
    for (const cell of this.cells) cell.map.draw({ ...common, ...pictureOf(cell, view.map, unit) });
    this.describePointer(slice, view.map, unit);
  }

  private common(verb: Verb, slice: Slice, view: View, scale: Scale) {
    const { [slice.across.name]: across, [slice.up.name]: up } = view.goal;
    const through = slice.fixed.every(([adverb, value]) => {
      return Math.abs((view.goal[adverb.name] ?? value) - value) <= (adverb.max - adverb.min) / 200;
    });
    return {
      key: view.map,
      scale,
      slice,
      dots: near(slice, verb.examples),
      pseudo: view.pseudo ? near(slice, verb.pseudo_examples) : [],
      goal: across === undefined || up === undefined ? null : ([across, up] as const),
      through,
      pointed: this.pointed,
    };
  }

  private legend(map: View["map"], scale: Scale, unit: Unit): void {
    this.caption.textContent = {
      error: `Error, ${unit.text}`,
      smoothness: `κ of the weights, ${NODES} nodes per side`,
      support: "Support: 100\u00a0% at an example, 50\u00a0% where the motion is as uncertain as a left-out example",
    }[map];
    const texts = scale.ticks.map((tick) => (map === "error" ? digits(tick, 0) : valueText(map, tick, unit)));
    this.ticks.replaceChildren(...texts.map((text) => h("span", {}, text)));
  }

  /** Values of all maps under the pointer. */
  private describePointer(slice: Slice, key: View["map"], unit: Unit): void {
    const { pointed } = this;
    const axes = slice.across === slice.up ? [slice.across] : [slice.across, slice.up];
    if (!pointed) {
      this.status.textContent = axes.map((adverb, k) => axisText(k === 0 ? "→" : "↑", adverb)).join("   ");
      return;
    }
    const place = axes
      .map((adverb, k) => `${adverb.name} ${adverbText(pointed[k] ?? Number.NaN, adverb.unit)}`)
      .join(", ");
    const values = this.cells.map((cell) => {
      const value = cell.quality && lookUp(cell.quality, key, ...pointed);
      return `${titleOf(cell)} ${valueText(key, value, unit)}`;
    });
    this.status.textContent = `${place}: ${values.join(" · ")}`;
  }
}

function scaleOf(map: View["map"], known: readonly Quality[], most: number, unit: Unit): Scale {
  if (map === "support") return SHARES;
  if (map === "smoothness")
    return logScale(known.flatMap(({ smoothness }) => smoothness.flat().filter((value) => value !== null)));
  const errors = linearScale(most * unit.factor);
  return { ...errors, at: (value) => errors.at(value * unit.factor) };
}

function valueText(map: View["map"], value: number | null, { text, factor }: Unit): string {
  if (value === null) return "–";
  if (map === "error") return `${digits(value * factor)} ${text}`;
  return map === "support" ? shareText(value) : kappa(value);
}

const MAP_KINDS = [
  ["error", "Error"],
  ["smoothness", "Smoothness κ"],
  ["support", "Support"],
] as const;

function drop(cell: Cell): void {
  cell.source.stop();
  cell.map.dispose();
}

function titleOf({ method, version }: Pick<Cell, "method" | "version">): string {
  return version === null ? methodLabel(method) : `${methodLabel(method)}, version ${version}`;
}

function pictureOf(
  cell: Cell,
  key: View["map"],
  unit: Unit,
): Pick<Picture, "title" | "figures" | "problem" | "pending" | "quality"> {
  const { quality, problem } = cell;
  const figures = quality ? figuresText(key, quality, unit) : "Computing…";
  return {
    title: titleOf(cell),
    figures: problem || figures,
    problem: problem !== "",
    pending: cell.source.pending,
    quality,
  };
}

/** Mean and worst value of a map. */
export function figuresText(map: View["map"], quality: Quality, unit: Unit): string {
  const mean = quality[`${map}_mean`];
  if (mean === null) return NOTHING[map];
  if (map === "support") return `mean ${shareText(mean)}, min ${shareText(quality.support_min)}`;
  if (map === "smoothness") return `mean ${kappa(mean)}, max ${kappa(quality.smoothness_max)}`;
  return `mean ${digits(mean * unit.factor)}, max ${valueText(map, quality.error_max, unit)}`;
}

const NOTHING: Record<View["map"], string> = {
  error: "no measured goal",
  smoothness: "no node with all neighbours inside the domain",
  support: "no node inside the domain",
};

function axisText(arrow: string, { name, min, max, unit }: Slice["across"]): string {
  const { text, factor } = adverbUnit(unit);
  return `${arrow} ${name} ${digits(min * factor)} to ${digits(max * factor)} ${text}`;
}

function adverbText(value: number, unit: string): string {
  const { text, factor } = adverbUnit(unit);
  return `${digits(value * factor)} ${text}`;
}

/** Reason why some methods are unavailable. */
function unavailableText({ methods, measure }: Verb): string {
  const missing = (...names: string[]) => names.filter((name) => !methods.includes(name)).map(methodLabel);
  if (measure.kind === "none")
    return `${missing("search", "hybrid", "corrected").join(", ")}: unavailable, since this verb has no measured goal.`;
  const later = missing("refined", "hybrid");
  return later.length > 0 ? `${later.join(", ")}: available after a refinement.` : "";
}
