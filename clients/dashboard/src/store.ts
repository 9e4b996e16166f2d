/** The view, and the link that holds it: every field stands in the page's address, bad ones fall back. */

import type { Against, Store, View } from "./types";

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
  against: { kind: "nothing" },
  hull: true,
  examples: true,
  pseudo: false,
  follow: true,
  detail: "high",
  theme: "auto",
  panel: "verb",
  camera: null,
  across: "",
  up: "",
  map: "error",
  maps: [],
  slice: null,
};

/** What is allowed; the controls keep to the same bounds. */
export const BOUNDS = {
  phase: [0, 1],
  speed: [-2, 2],
  fps: [1, 120],
  crowd: [1, 1000],
  number: [-1e9, 1e9],
} as const;

const LONGEST_NAME = 200;
const GOAL = "at.";
const SLICE = "slice.";
const MOST_ADVERBS = 16;
const MOST_MAPS = 16;
const WRITE_AFTER_MS = 250;

/** One field and its words in the address; `read` gives undefined for what is not allowed. */
interface Words<Value> {
  read(text: string): Value | undefined;
  write(value: Value): string;
}

const name: Words<string> = {
  read: (text) => (text.length <= LONGEST_NAME ? text : undefined),
  write: (value) => value,
};

const flag: Words<boolean> = {
  read: (text) => (text === "yes" ? true : text === "no" ? false : undefined),
  write: (value) => (value ? "yes" : "no"),
};

function within([low, high]: readonly [number, number], whole = false): Words<number> {
  return {
    read: (text) => {
      const value = text.trim() === "" ? Number.NaN : Number(text);
      return value >= low && value <= high && (!whole || Number.isInteger(value)) ? value : undefined;
    },
    write: String,
  };
}

function oneOf<Value extends string>(...values: Value[]): Words<Value> {
  return { read: (text) => values.find((value) => value === text), write: (value) => value };
}

const number = within(BOUNDS.number);

const against: Words<Against> = {
  read: (text) => {
    const [kind, rest] = [text.slice(0, text.indexOf(":")), text.slice(text.indexOf(":") + 1)];
    if (text === "nothing") return { kind: "nothing" };
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

const camera: Words<readonly number[] | null> = {
  read: (text) => {
    const values = text.split(",").map(number.read);
    return values.length === 6 && values.every((value) => value !== undefined) ? values : undefined;
  },
  write: (value) => (value ?? []).join(),
};

const names: Words<readonly string[]> = {
  read: (text) => {
    const values = text.split(",");
    return values.length <= MOST_MAPS && values.every((value) => value && name.read(value)) ? values : undefined;
  },
  write: (values) => values.join(),
};

const WORDS: { [Key in Exclude<keyof View, "goal" | "slice">]: Words<View[Key]> } = {
  verb: name,
  method: name,
  phase: within(BOUNDS.phase),
  playing: flag,
  speed: within(BOUNDS.speed),
  loop: flag,
  fps: within(BOUNDS.fps, true),
  encoding: oneOf("f32", "q48"),
  crowd: within(BOUNDS.crowd, true),
  against,
  hull: flag,
  examples: flag,
  pseudo: flag,
  follow: flag,
  detail: oneOf("high", "low"),
  theme: oneOf("auto", "light", "dark"),
  panel: oneOf("verb", "quality", "versions", "service", "add"),
  camera,
  across: name,
  up: name,
  map: oneOf("error", "smoothness"),
  maps: names,
};

/** The view that a link's hash holds; what is missing or not allowed is as in `base`. */
export function readView(hash: string, base: View = DEFAULTS): View {
  const words = new URLSearchParams(hash.replace(/^#/, ""));
  const view: Record<string, unknown> = { ...base };
  for (const [key, { read }] of Object.entries(WORDS)) {
    const text = words.get(key);
    const value = text === null ? undefined : read(text);
    if (value !== undefined) view[key] = value;
  }
  const adverbs = { goal: readAdverbs(words, GOAL) ?? base.goal, slice: readAdverbs(words, SLICE) ?? base.slice };
  return { ...(view as unknown as View), ...adverbs };
}

/** Numbers by the rest of their keys, which begin with the same prefix; null where there are none. */
function readAdverbs(words: URLSearchParams, prefix: string): Record<string, number> | null {
  const found = [...words]
    .filter(([key, text]) => key.startsWith(prefix) && name.read(key) && number.read(text) !== undefined)
    .slice(0, MOST_ADVERBS)
    .map(([key, text]) => [key.slice(prefix.length), Number(text)]);
  return found.length > 0 ? Object.fromEntries(found) : null;
}

/** The hash that holds a view: what differs from the defaults. */
export function writeView(view: View): string {
  const words = new URLSearchParams();
  for (const key of Object.keys(WORDS) as (keyof typeof WORDS)[]) {
    const { write } = WORDS[key] as Words<unknown>;
    if (!same(view[key], DEFAULTS[key])) words.set(key, write(view[key]));
  }
  for (const [key, value] of Object.entries(view.goal)) words.set(GOAL + key, String(value));
  for (const [key, value] of Object.entries(view.slice ?? {})) words.set(SLICE + key, String(value));
  const text = words.toString();
  return text && `#${text}`;
}

/** Whether two values of a field mean the same. */
export function same(a: unknown, b: unknown): boolean {
  return a === b || JSON.stringify(a) === JSON.stringify(b);
}

export function createStore(initial: View): Store {
  let view = initial;
  const listeners = new Set<{ keys: readonly (keyof View)[]; then: (view: View, before: View) => void }>();
  return {
    get view() {
      return view;
    },
    change(part) {
      const keys = (Object.keys(part) as (keyof View)[]).filter((key) => !same(part[key], view[key]));
      if (keys.length === 0) return;
      const before = view;
      view = { ...view, ...part };
      for (const listener of [...listeners])
        if (listeners.has(listener) && listener.keys.some((key) => keys.includes(key))) listener.then(view, before);
    },
    on(keys, then) {
      const listener = { keys, then };
      listeners.add(listener);
      return () => void listeners.delete(listener);
    },
  };
}

/** Keep the address and the view the same; the address follows a quarter of a second later, without history. */
export function syncAddress(store: Store, page: Window = window): void {
  let timer: ReturnType<typeof setTimeout> | undefined;
  const write = () => page.history.replaceState(null, "", writeView(store.view) || page.location.pathname);
  store.on(Object.keys(DEFAULTS) as (keyof View)[], () => {
    clearTimeout(timer);
    timer = setTimeout(write, WRITE_AFTER_MS);
  });
  page.addEventListener("hashchange", () => {
    clearTimeout(timer);
    store.change(readView(page.location.hash));
  });
}
