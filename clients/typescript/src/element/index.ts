/**
 * `<adverb-figure verb="reach" x="-0.3" y="1.2" z="0.4">`: a figure for any page, streamed and drawn.
 *
 * | attribute | |
 * | --- | --- |
 * | `server` | address; default: the server of the page |
 * | `verb` | name of the verb |
 * | adverbs by name | goal, in the verb's units; default: the middle of the domain |
 * | `method`, `fps`, `speed` | as in `open` of the stream |
 * | `phase` | shows one pose, 0 to 1, instead of the motion |
 * | `paused` | holds the motion |
 * | `yaw` | direction of view, degrees; dragging changes it |
 *
 * The property `key` has the key of the server. The colour is that of the text, or `--adverb-figure-color`. The events
 * `load` and `error` (with the error as `detail`) report the figure. Elements of one server share a connection.
 * Without a connection the element tries again every 5 s.
 */

import { AdverbError, TransportError } from "../errors.js";
import type { Figure, FigureSettings } from "../stream/figure.js";
import { connect } from "../stream/stream.js";
import { bodyOf } from "./body.js";
import { type Connection, Connections } from "./connections.js";
import { Painter, rgbOf } from "./painter.js";

const STYLE = `
:host { display: inline-block; position: relative; width: 20rem; height: 20rem; color: #4f7fcf; touch-action: pan-y; }
:host([hidden]) { display: none; }
canvas { display: block; width: 100%; height: 100%; cursor: grab; }
p { position: absolute; inset: 0; margin: auto; height: fit-content; padding: 1rem; text-align: center;
  font: 0.875rem/1.4 system-ui, sans-serif; color: #667085; }
`;
const OPENING = ["server", "verb", "method"];
const DEGREE = Math.PI / 180;

/** Pause after an attempt without a connection, ms. */
const RETRY_MS = 5_000;

const connections = new Connections((server, key) => connect(server, { key }));

export class AdverbFigure extends HTMLElement {
  /** Key of the server. */
  key = "";
  private readonly canvas = document.createElement("canvas");
  private readonly text = document.createElement("p");
  private readonly attributesObserver = new MutationObserver((rows) => this.changed(rows));
  private readonly visibility = new IntersectionObserver((rows) => {
    this.visible = rows.at(-1)?.isIntersecting ?? true;
    if (this.visible) this.schedule();
  });
  private visible = true;
  private figure: Figure | null = null;
  private painter: Painter | null = null;
  private used: Connection | null = null;
  private retry: ReturnType<typeof setTimeout> | undefined;
  private frame = 0;
  /** Number of the last opening; earlier ones are given up. */
  private opening = 0;
  private turned = 0;

  constructor() {
    super();
    const style = document.createElement("style");
    style.textContent = STYLE;
    this.attachShadow({ mode: "open" }).append(style, this.canvas, this.text);
    this.canvas.addEventListener("pointerdown", (event) => this.canvas.setPointerCapture(event.pointerId));
    this.canvas.addEventListener("pointermove", (event) => {
      if (this.canvas.hasPointerCapture(event.pointerId)) this.turned -= event.movementX * 0.5 * DEGREE;
    });
  }

  connectedCallback(): void {
    this.attributesObserver.observe(this, { attributes: true });
    this.visibility.observe(this);
    void this.open();
  }

  disconnectedCallback(): void {
    this.attributesObserver.disconnect();
    this.visibility.disconnect();
    this.close();
  }

  /** The figure on the stream; null before it is open. */
  get stream(): Figure | null {
    return this.figure;
  }

  private async open(): Promise<void> {
    this.close();
    const verb = this.getAttribute("verb");
    if (!verb) return this.show("The attribute “verb” is missing.");
    const turn = ++this.opening;
    this.used = connections.acquire(this.getAttribute("server") ?? "", this.key);
    this.show("Loading …");
    try {
      const stream = await this.used.stream;
      if (turn !== this.opening) return;
      const description = await stream.client.verb(verb);
      if (turn !== this.opening) return;
      const method = this.getAttribute("method");
      const names = description.adverbs.map(({ name }) => name);
      const figure = await stream.open(verb, {
        ...this.settings(names),
        encoding: "q48",
        events: false,
        ...(method && { method }),
      });
      if (turn !== this.opening) return figure.close();
      this.figure = figure;
      const context = this.canvas.getContext("2d");
      if (context) this.painter = new Painter(context, bodyOf(description));
      this.show("");
      this.schedule();
      this.dispatchEvent(new CustomEvent("load"));
    } catch (err) {
      if (turn !== this.opening) return;
      this.release();
      if (err instanceof TransportError) this.retry = setTimeout(() => void this.open(), RETRY_MS);
      this.show(err instanceof AdverbError ? err.detail : String(err));
      this.dispatchEvent(new CustomEvent("error", { detail: err }));
    }
  }

  private close(): void {
    this.opening++;
    cancelAnimationFrame(this.frame);
    this.frame = 0;
    this.figure?.close();
    this.figure = this.painter = null;
    clearTimeout(this.retry);
    this.release();
  }

  private release(): void {
    if (this.used) connections.release(this.used);
    this.used = null;
  }

  private changed(rows: readonly MutationRecord[]): void {
    if (rows.some(({ attributeName }) => OPENING.includes(attributeName ?? ""))) void this.open();
    else if (this.figure) this.figure.set(this.settings(this.figure.verb.adverbs.map(({ name }) => name)));
  }

  /** Settings by attributes; those of adverbs have their names. */
  private settings(names: readonly string[]): FigureSettings {
    const number = (name: string) => {
      const text = this.getAttribute(name);
      return text === null || text.trim() === "" || !Number.isFinite(Number(text)) ? undefined : Number(text);
    };
    const goal = names.flatMap((name) => {
      const value = number(name);
      return value === undefined ? [] : [[name, value] as const];
    });
    const [phase, fps, speed] = [number("phase"), number("fps"), number("speed")];
    return {
      adverbs: Object.fromEntries(goal),
      playing: phase === undefined && !this.hasAttribute("paused"),
      loop: true,
      ...(phase !== undefined && { phase }),
      ...(fps !== undefined && { fps }),
      ...(speed !== undefined && { speed }),
    };
  }

  private schedule(): void {
    if (this.frame || !this.visible || !this.figure) return;
    this.frame = requestAnimationFrame((atMs) => {
      this.frame = 0;
      this.draw(atMs);
      this.schedule();
    });
  }

  private draw(atMs: number): void {
    const pose = this.figure?.pose(atMs);
    const { painter, canvas } = this;
    if (!pose || !painter) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(ratio * canvas.clientWidth), Math.round(ratio * canvas.clientHeight)];
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const context = canvas.getContext("2d") as CanvasRenderingContext2D;
    const style = getComputedStyle(this);
    const color = rgbOf(context, style.getPropertyValue("--adverb-figure-color").trim() || style.color);
    const yaw = Number(this.getAttribute("yaw") ?? 25) * DEGREE + this.turned;
    const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
    painter.draw(pose.values, { yaw, width, height, color, dark });
    this.toggleAttribute("drawn", true);
  }

  private show(text: string): void {
    this.text.textContent = text;
    this.text.hidden = text === "";
  }
}

if (!customElements.get("adverb-figure")) customElements.define("adverb-figure", AdverbFigure);
