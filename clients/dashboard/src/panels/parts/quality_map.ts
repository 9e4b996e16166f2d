/** One quality map: a method's values over a slice, with goal, examples and pointer position. */

import { h } from "../../shell/dom";
import type { View } from "../../types";
import { indexOf, PALETTE, type Scale } from "./colours";
import { type Dot, type Quality, type Slice, share, valueAt } from "./slice";

export type Place = readonly [across: number, up: number];

export interface Picture {
  title: string;
  /** Mean and worst value, or the reason for a missing map. */
  figures: string;
  problem: boolean;
  /** Whether a newer map is being loaded. */
  pending: boolean;
  quality: Quality | null;
  key: View["map"];
  scale: Scale;
  slice: Slice;
  dots: readonly Dot[];
  pseudo: readonly Dot[];
  goal: Place | null;
  /** Whether the slice contains the goal. */
  through: boolean;
  pointed: Place | null;
}

export interface MapActs {
  point(place: Place | null): void;
  choose(place: Place): void;
}

const NARROWEST = 0.6;
const TALLEST = 1.25;
const LINE_HEIGHT = 0.12;

export class QualityMap {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { role: "img" });
  private readonly title = h("span", { className: "map-title" });
  private readonly figures = h("span", { className: "map-figures" });
  private readonly cells = document.createElement("canvas");
  private readonly sizes = new ResizeObserver(() => this.picture && this.draw(this.picture));
  private picture: Picture | null = null;

  constructor(private readonly acts: MapActs) {
    this.element = h("figure", { className: "map" }, this.title, this.canvas, this.figures);
    this.canvas.onpointermove = (event) => this.acts.point(this.goalSpaceOf(event));
    this.canvas.onpointerleave = () => this.acts.point(null);
    this.canvas.onclick = (event) => {
      const place = this.goalSpaceOf(event);
      if (place) this.acts.choose(place);
    };
    this.sizes.observe(this.canvas);
  }

  dispose(): void {
    this.sizes.disconnect();
    this.element.remove();
  }

  draw(picture: Picture): void {
    this.picture = picture;
    this.title.textContent = picture.title;
    this.figures.textContent = picture.figures;
    this.figures.classList.toggle("problem", picture.problem);
    this.element.classList.toggle("pending", picture.pending);
    this.canvas.ariaLabel = `${picture.title}: ${picture.figures}`;
    this.canvas.style.aspectRatio = String(1 / heightOf(picture.slice));
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    const [across, up] = [Math.round(width * devicePixelRatio), Math.round(height * devicePixelRatio)];
    if (this.canvas.width !== across || this.canvas.height !== up)
      Object.assign(this.canvas, { width: across, height: up });
    const pen = this.canvas.getContext("2d");
    if (!pen) return;
    pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    pen.clearRect(0, 0, width, height);
    if (picture.quality) this.paint(pen, picture.quality, picture, width, height);
    this.mark(pen, picture, width, height);
  }

  /** Paint one pixel per node and scale it up. */
  private paint(
    pen: CanvasRenderingContext2D,
    quality: Quality,
    { key, scale }: Picture,
    width: number,
    height: number,
  ) {
    const rows = quality[key];
    const size = { width: quality.columns.length, height: rows.length };
    const image = new ImageData(size.width, size.height);
    rows.forEach((row, r) => {
      row.forEach((value, c) => {
        if (value === null) return;
        const from = 3 * indexOf(scale.at(value));
        const to = 4 * ((size.height - 1 - r) * size.width + c);
        image.data.set(PALETTE.subarray(from, from + 3), to);
        image.data[to + 3] = 255;
      });
    });
    Object.assign(this.cells, size);
    this.cells.getContext("2d")?.putImageData(image, 0, 0);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(this.cells, 0, 0, width, height);
  }

  private mark(pen: CanvasRenderingContext2D, picture: Picture, width: number, height: number): void {
    const { slice, quality, goal, pointed, through } = picture;
    const nodes = [quality?.columns.length ?? 1, quality?.rows.length ?? 1] as const;
    const put = (across: number, up: number): readonly [number, number] => [
      width * share(slice.across, across, nodes[0]),
      height * (nodes[1] > 1 ? 1 - share(slice.up, up, nodes[1]) : 0.5),
    ];
    if (!quality) return;
    for (const dot of picture.pseudo) disc(pen, put(dot.across, dot.up), 1.5, 0.35 + 0.5 * dot.near);
    for (const dot of picture.dots) disc(pen, put(dot.across, dot.up), 3, 0.35 + 0.65 * dot.near);
    if (goal) cross(pen, put(...goal), through);
    if (pointed) ring(pen, put(...pointed));
  }

  private goalSpaceOf({ offsetX, offsetY }: MouseEvent): Place | null {
    const { picture } = this;
    if (!picture?.quality) return null;
    const { clientWidth, clientHeight } = this.canvas;
    const { columns, rows } = picture.quality;
    const { across, up } = picture.slice;
    return [
      valueAt(across, offsetX / clientWidth, columns.length),
      valueAt(up, 1 - offsetY / clientHeight, rows.length),
    ];
  }
}

/** Aspect ratio (height / width): to scale if both axes share a unit, within limits. */
function heightOf({ across, up }: Slice): number {
  if (across === up) return LINE_HEIGHT;
  if (across.unit !== up.unit) return 1;
  return Math.min(Math.max((up.max - up.min) / (across.max - across.min || 1), NARROWEST), TALLEST);
}

type Pen = CanvasRenderingContext2D;
type Point = readonly [x: number, y: number];

function disc(pen: Pen, [x, y]: Point, radius: number, opacity: number): void {
  pen.globalAlpha = opacity;
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fillStyle = "#fff";
  pen.fill();
  pen.lineWidth = 1;
  pen.strokeStyle = "#000";
  pen.stroke();
  pen.globalAlpha = 1;
}

/** White on black outline, visible on every colour; smaller if the goal is not on the slice. */
function cross(pen: Pen, [x, y]: Point, through: boolean): void {
  const arm = through ? 8 : 5;
  pen.beginPath();
  pen.moveTo(x - arm, y);
  pen.lineTo(x + arm, y);
  pen.moveTo(x, y - arm);
  pen.lineTo(x, y + arm);
  twice(pen, through ? 2 : 1);
}

function ring(pen: Pen, [x, y]: Point): void {
  pen.beginPath();
  pen.arc(x, y, 5, 0, 2 * Math.PI);
  twice(pen, 1);
}

function twice(pen: Pen, width: number): void {
  pen.lineCap = "round";
  pen.lineWidth = width + 2;
  pen.strokeStyle = "#000";
  pen.stroke();
  pen.lineWidth = width;
  pen.strokeStyle = "#fff";
  pen.stroke();
}
