/** DOM helpers: `h` creates an element from properties, attributes, listeners and children. */

type Child = Node | string | number | null | false;
type Props<Tag extends keyof HTMLElementTagNameMap> = Partial<Omit<HTMLElementTagNameMap[Tag], "style">> &
  Record<
    `aria-${string}` | `data-${string}` | "role" | "for" | "style" | "list",
    string | number | boolean | undefined
  >;

export function h<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag,
  props: Partial<Props<Tag>> = {},
  ...children: Child[]
): HTMLElementTagNameMap[Tag] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined) continue;
    if (name in element && !name.startsWith("aria-")) Reflect.set(element, name, value);
    else element.setAttribute(name, String(value));
  }
  element.append(...children.filter((child) => child !== null && child !== false).map(asNode));
  return element;
}

function asNode(child: Exclude<Child, null | false>): Node | string {
  return typeof child === "number" ? String(child) : child;
}

/** Select box with a visible label. */
export function choice(
  label: string,
  options: readonly (readonly [value: string, text: string])[],
  changed: (value: string) => void,
) {
  const select = h("select", { onchange: () => changed(select.value) });
  setOptions(select, options);
  return { element: h("label", { className: "choice" }, h("span", {}, label), select), select };
}

/** Replace the options; keeps the selected value if it still exists. */
export function setOptions(select: HTMLSelectElement, options: readonly (readonly [string, string])[]): void {
  const { value } = select;
  select.replaceChildren(...options.map(([option, text]) => h("option", { value: option }, text)));
  if (options.some(([option]) => option === value)) select.value = value;
}

/** Checkbox with a label. */
export function toggle(label: string, changed: (on: boolean) => void) {
  const box = h("input", { type: "checkbox", onchange: () => changed(box.checked) });
  return { element: h("label", { className: "toggle" }, box, h("span", {}, label)), box };
}

/** Stroke icon on a 16 × 16 grid. */
export function icon(path: string): SVGSVGElement {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  const stroke = document.createElementNS("http://www.w3.org/2000/svg", "path");
  stroke.setAttribute("d", path);
  svg.append(stroke);
  return svg;
}
