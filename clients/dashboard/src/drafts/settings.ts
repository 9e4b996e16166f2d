/** Fields of a draft: name, description, measure, effector, keytimes and adverbs. */

import { choice, h, setOptions } from "../shell/dom";
import { digits } from "../units";
import type { Draft, DraftEdit } from "./types";

const MEASURES: Record<string, string> = {
  joint_position: "position of a joint",
  jump: "jump",
  root_velocity: "velocity of the root",
  none: "nothing",
};

/** Window width below which the fields are closed at first. */
const NARROW_PX = 760;

type Edit = (edit: DraftEdit) => void;

/** A text field that sends its value when it is left. */
function field(label: string, changed: (value: string) => void, className = "field") {
  const input = h("input", { type: "text", onchange: () => changed(input.value.trim()) });
  const show = (value: string) => {
    if (document.activeElement !== input) input.value = value;
  };
  return { element: h("label", { className }, h("span", {}, label), input), show };
}

export function settings(edit: Edit): { element: HTMLElement; show(draft: Draft): void } {
  const name = field("Name", (value) => value && edit({ name: value }));
  const description = field("Description", (value) => edit({ description: value }));
  const measure = choice("Measure", [], (value) => edit({ measure: value }));
  const effector = choice("Effector", [], (value) => edit({ effector: value }));
  const at = choice("Measured at", [], (value) => edit({ effector_keytime_index: Number(value) }));
  const names = h("div", { className: "name-fields", role: "group", "aria-label": "Keytime names" });
  const adverbs = h("div", { className: "name-fields", role: "group", "aria-label": "Adverb names" });
  let fields = "";
  const show = (draft: Draft) => {
    name.show(draft.name);
    description.show(draft.description);
    const measures = [...new Set([...draft.measures, draft.measure])];
    setOptions(
      measure.select,
      measures.map((each) => [each, MEASURES[each] ?? each.replaceAll("_", " ")]),
    );
    measure.select.value = draft.measure;
    setOptions(
      effector.select,
      draft.joints.map((joint) => [joint, joint]),
    );
    effector.select.value = draft.effector ?? "";
    effector.element.hidden = draft.effector === null;
    at.element.hidden = draft.measure !== "joint_position";
    setOptions(
      at.select,
      draft.keytime_names.map((each, k) => [String(k), each]),
    );
    at.select.value = String(draft.effector_keytime_index);
    const key = JSON.stringify([draft.keytime_names, draft.adverbs, draft.verb?.adverbs]);
    if (key === fields) return;
    fields = key;
    names.replaceChildren(...keytimeFields(draft, edit));
    adverbs.replaceChildren(...adverbFields(draft, edit));
  };
  const element = h(
    "details",
    { className: "draft-settings", open: innerWidth > NARROW_PX },
    h("summary", {}, "Name, measure, keytimes and adverbs"),
    h("div", { className: "draft-names" }, name.element, description.element),
    h("div", { className: "draft-choices" }, measure.element, effector.element, at.element),
    h("div", { className: "draft-rows" }, h("h2", {}, "Keytimes"), names, h("h2", {}, "Adverbs"), adverbs),
  );
  return { element, show };
}

function keytimeFields({ keytime_names: names }: Draft, edit: Edit): HTMLElement[] {
  return names.map((name, k) => {
    const input = h("input", {
      type: "text",
      value: name,
      "aria-label": `Name of keytime ${k + 1}`,
      onchange: () => {
        const value = input.value.trim();
        if (value) edit({ keytime_names: names.map((each, i) => (i === k ? value : each)) });
        else input.value = name;
      },
    });
    return input;
  });
}

function adverbFields({ adverbs, verb }: Draft, edit: Edit): HTMLElement[] {
  const list = (k: number, part: { name: string }) =>
    adverbs.map(({ name, unit, description, style }, i) => ({ name, unit, description, style, ...(i === k && part) }));
  return adverbs.map(({ name, unit, description }, k) => {
    const input = h("input", {
      type: "text",
      value: name,
      title: description,
      "aria-label": `Name of adverb ${k + 1}`,
      onchange: () => {
        const value = input.value.trim();
        if (value) edit({ adverbs: list(k, { name: value }) });
        else input.value = name;
      },
    });
    const range = verb?.adverbs[k];
    const unitText = unit === "none" ? "" : unit;
    const text = range ? `${digits(range.min)} to ${digits(range.max)} ${unitText}` : unitText;
    return h("div", { className: "adverb-field" }, input, h("small", {}, text));
  });
}
