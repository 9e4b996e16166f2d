import type { PerspectiveCamera, Vector3 } from "three";

/** Text label at a position in the picture, as a DOM element. */
export class Label {
  readonly element = document.createElement("div");
  readonly #host: HTMLElement;

  constructor(host: HTMLElement, kind: "chip" | "plain") {
    this.#host = host;
    this.element.className = `scene-label scene-label-${kind}`;
    Object.assign(this.element.style, {
      position: "absolute",
      left: "0",
      top: "0",
      pointerEvents: "none",
      whiteSpace: "nowrap",
      font: "500 12px/16px system-ui, sans-serif",
      fontVariantNumeric: "tabular-nums",
      color: kind === "chip" ? "var(--ink, #1c2430)" : "var(--quiet, #66717f)",
      willChange: "transform",
      visibility: "hidden",
    });
    if (kind === "chip") {
      Object.assign(this.element.style, {
        padding: "2px 8px",
        background: "var(--panel, #fff)",
        border: "1px solid var(--line, #d5dae1)",
        borderRadius: "var(--radius, 4px)",
      });
    }
    this.element.setAttribute("aria-hidden", "true");
    host.append(this.element);
  }

  hide(): void {
    this.element.style.visibility = "hidden";
  }

  /** Show `text` beside a world position, inside the picture; overwrites `point`. */
  show(text: string, point: Vector3, camera: PerspectiveCamera, aside: number): void {
    point.project(camera);
    const { clientWidth: wide, clientHeight: high } = this.#host;
    if (point.z > 1 || Math.abs(point.x) > 1 || Math.abs(point.y) > 1) {
      this.hide();
      return;
    }
    if (this.element.textContent !== text) this.element.textContent = text;
    const { offsetWidth, offsetHeight } = this.element;
    const x = Math.min((point.x * 0.5 + 0.5) * wide + aside, wide - offsetWidth - 8);
    const y = (0.5 - point.y * 0.5) * high - offsetHeight / 2;
    this.element.style.transform = `translate(${Math.round(x)}px, ${Math.round(Math.max(y, 8))}px)`;
    this.element.style.visibility = "visible";
  }

  dispose(): void {
    this.element.remove();
  }
}
