/** The view and its link: every field is stored in the URL hash; invalid fields fall back to defaults. */

import type { Comparison, Store, View } from "./types";

export const DEFAULTS: View = {
  verb: "",
  method: "",
  goal: {},
  phase: 0,
  playing: true,
  speed: 1,
  loop: true,
  fps: 60,
  encoding: "f32",
  crowd: 1,
  crowdPoses: false,
  compare: { kind: "none" },
  hull: true,
  examples: true,
  pseudo: false,
  follow: true,
  detail: "high",
  theme: "auto",
  drive: false,
  panel: "verb",
  draft: "",
  clip: "",
  figure: "",
  figureGoal: "scaled",
  camera: null,
  across: "",
  up: "",
  map: "error",
  maps: [],
  slice: null,
};

/** Valid ranges, shared with the controls. */
export const BOUNDS = {
  phase: [0, 1],
  speed: [-2, 2],
  fps: [1, 120],
  crowd: [1, 2000],
  number: [-1e9, 1e9],
} as const;

const LONGEST_NAME = 200;
const GOAL = "at.";
const SLICE = "slice.";
const MOST_ADVERBS = 16;
const MOST_MAPS = 16;
const WRITE_AFTER_MS = 250;

/** Text encoding of one field; `read` returns undefined for invalid text. */
interface Codec<Value> {
  read(text: string): Value | undefined;
  write(value: Value): string;
}

const name: Codec<string> = {
  read: (text) => (text.length <= LONGEST_NAME ? text : undefined),
  write: (value) => value,
};

const flag: Codec<boolean> = {
  read: (text) => (text === "yes" ? true : text === "no" ? false : undefined),
  write: (value) => (value ? "yes" : "no"),
};

function within([low, high]: readonly [number, number], whole = false): Codec<number> {
  return {
    read: (text) => {
      const value = text.trim() === "" ? Number.NaN : Number(text);
      return value >= low && value <= high && (!whole || Number.isInteger(value)) ? value : undefined;
    },
    write: String,
  };
}

function oneOf<Value extends string>(...values: Value[]): Codec<Value> {
  return { read: (text) => values.find((value) => value === text), write: (value) => value };
}

const number = within(BOUNDS.number);

const compare: Codec<Comparison> = {
  read: (text) => {
    const [kind, rest] = [text.slice(0, text.indexOf(":")), text.slice(text.indexOf(":") + 1)];
    if (text === "none") return { kind: "none" };
    if (kind === "method" && rest && name.read(rest)) return { kind, method: rest };
    const version = within([1, 2 ** 32 - 1], true).read(rest);
    return kind === "version" && version !== undefined ? { kind, version } : undefined;
  },
  write: (value) =>
    value.kind === "method"
      ? `method:${value.method}`
      : value.kind === "version"
        ? `version:${value.version}`
        : value.kind,
};

const camera: Codec<readonly number[] | null> = {
  read: (text) => {
    const values = text.split(",").map(number.read);
    return values.length === 6 && values.every((value) => value !== undefined) ? values : undefined;
  },
  write: (value) => (value ?? []).join(),
};

const names: Codec<readonly string[]> = {
  read: (text) => {
    const values = text.split(",");
    return values.length <= MOST_MAPS && values.every((value) => value && name.read(value)) ? values : undefined;
  },
  write: (values) => values.join(),
};

const CODECS: { [Key in Exclude<keyof View, "goal" | "slice">]: Codec<View[Key]> } = {
  verb: name,
  method: name,
  phase: within(BOUNDS.phase),
  playing: flag,
  speed: within(BOUNDS.speed),
  loop: flag,
  fps: within(BOUNDS.fps, true),
  encoding: oneOf("f32", "q48", "q32"),
  crowd: within(BOUNDS.crowd, true),
  crowdPoses: flag,
  compare,
  hull: flag,
  examples: flag,
  pseudo: flag,
  follow: flag,
  detail: oneOf("high", "low"),
  theme: oneOf("auto", "light", "dark"),
  drive: flag,
  panel: oneOf("verb", "quality", "versions", "service", "upload"),
  draft: name,
  clip: name,
  figure: name,
  figureGoal: oneOf("scaled", "world"),
  camera,
  across: name,
  up: name,
  map: oneOf("error", "smoothness", "support"),
  maps: names,
};

/** Parse a link's hash; missing and invalid fields are taken from `base`. */
export function readView(hash: string, base: View = DEFAULTS): View {
  const words = new URLSearchParams(hash.replace(/^#/, ""));
  const view: Record<string, unknown> = { ...base };
  for (const [key, { read }] of Object.entries(CODECS)) {
    const text = words.get(key);
    const value = text === null ? undefined : read(text);
    if (value !== undefined) view[key] = value;
  }
  const adverbs = { goal: readAdverbs(words, GOAL) ?? base.goal, slice: readAdverbs(words, SLICE) ?? base.slice };
  return { ...(view as unknown as View), ...adverbs };
}

/** Numbers of all keys with a prefix, by the rest of the key; null if there are none. */
function readAdverbs(words: URLSearchParams, prefix: string): Record<string, number> | null {
  const found = [...words]
    .filter(([key, text]) => key.startsWith(prefix) && name.read(key) && number.read(text) !== undefined)
    .slice(0, MOST_ADVERBS)
    .map(([key, text]) => [key.slice(prefix.length), Number(text)]);
  return found.length > 0 ? Object.fromEntries(found) : null;
}

/** Hash of a view: the fields that differ from the defaults. */
export function writeView(view: View): string {
  const words = new URLSearchParams();
  for (const key of Object.keys(CODECS) as (keyof typeof CODECS)[]) {
    const { write } = CODECS[key] as Codec<unknown>;
    if (!same(view[key], DEFAULTS[key])) words.set(key, write(view[key]));
  }
  for (const [key, value] of Object.entries(view.goal)) words.set(GOAL + key, String(value));
  for (const [key, value] of Object.entries(view.slice ?? {})) words.set(SLICE + key, String(value));
  const text = words.toString();
  return text && `#${text}`;
}

/** Deep equality of two field values. */
export function same(a: unknown, b: unknown): boolean {
  return a === b || JSON.stringify(a) === JSON.stringify(b);
}

export function createStore(initial: View): Store {
  let view = initial;
  const listeners = new Set<{
    keys: readonly (keyof View)[];
    then: (view: View, before: View, push: boolean) => void;
  }>();
  return {
    get view() {
      return view;
    },
    change(part, push = false) {
      const keys = (Object.keys(part) as (keyof View)[]).filter((key) => !same(part[key], view[key]));
      if (keys.length === 0) return;
      const before = view;
      view = { ...view, ...part };
      for (const listener of [...listeners])
        if (listeners.has(listener) && listener.keys.some((key) => keys.includes(key)))
          listener.then(view, before, push);
    },
    on(keys, then) {
      const listener = { keys, then };
      listeners.add(listener);
      return () => void listeners.delete(listener);
    },
  };
}

/**
 * Keep the address and the view equal. Changes with `push` add a history entry at once, others replace the current
 * entry after a short delay. Back and forward restore the view of their entry.
 */
export function syncAddress(store: Store, page: Window = window): void {
  let timer: ReturnType<typeof setTimeout> | undefined;
  const addressOf = (view: View) => writeView(view) || page.location.pathname;
  const replace = (view: View) => {
    clearTimeout(timer);
    page.history.replaceState(null, "", addressOf(view));
  };
  store.on(Object.keys(DEFAULTS) as (keyof View)[], (view, before, push) => {
    clearTimeout(timer);
    if (push) {
      replace(before);
      page.history.pushState(null, "", addressOf(view));
    } else timer = setTimeout(() => replace(store.view), WRITE_AFTER_MS);
  });
  page.addEventListener("popstate", () => {
    store.change(readView(page.location.hash));
    clearTimeout(timer);
  });
}
