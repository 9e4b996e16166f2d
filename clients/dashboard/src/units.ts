/** Formats of numbers and units. */

/** A display unit: `factor` display units per server unit. */
export interface Unit {
  text: string;
  factor: number;
}

const METRES: Record<string, string> = { m: "", "m/s": "/s" };
const DEGREES = 180 / Math.PI;

/** Display unit of errors up to `most`: mm below 1 m, m above; "(SI)" for an error over adverbs of several dimensions. */
export function errorUnit(unit: string, most: number): Unit {
  const per = METRES[unit];
  if (unit === "SI") return { text: "(SI)", factor: 1 };
  if (per === undefined) return { text: unit, factor: 1 };
  return most < 1 ? { text: `mm${per}`, factor: 1000 } : { text: `m${per}`, factor: 1 };
}

/** Display unit of an adverb: degrees for angles, no text for numbers without unit, else the adverb's own unit. */
export function adverbUnit(unit: string): Unit {
  if (unit === "none") return { text: "", factor: 1 };
  if (unit === "rad") return { text: "°", factor: DEGREES };
  return unit === "rad/s" ? { text: "°/s", factor: DEGREES } : { text: unit, factor: 1 };
}

/** Error or distance in a suitable unit: mm below 1 m, m above. */
export function errorText(error: number | null | undefined, unit = "m"): string {
  if (error === null || error === undefined || Number.isNaN(error)) return "–";
  const { text, factor } = errorUnit(unit, error);
  const value = error * factor;
  const digits = factor === 1 || value < 10 ? 2 : value < 100 ? 1 : 0;
  return `${value.toFixed(digits)} ${text}`;
}

/** Slide of standing feet, mm; a dash if none stands. */
export function slideText(slide: number | null): string {
  return slide === null ? "–" : `${(1000 * slide).toFixed(1)} mm`;
}

/** Three significant digits; values below `least` become 0. */
export function digits(value: number, least = 0.005): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size < least) return "0";
  const text = size >= 100 ? size.toFixed(0) : String(Number(size.toPrecision(3)));
  return value < 0 ? `−${text}` : text;
}

const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/** Share as a whole percentage. */
export function shareText(share: number | null | undefined): string {
  return share === null || share === undefined ? "–" : `${Math.round(100 * share)} %`;
}

/** κ with two digits, small values as powers of ten. */
export function kappa(value: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0 || value >= 1e-4) return String(Number(value.toPrecision(2)));
  const [front, power = "0"] = value.toExponential(0).split("e");
  return `${front === "1" ? "" : `${front}·`}10${raised(power)}`;
}

function raised(power: string): string {
  return [...power].map((sign) => (sign === "-" ? "⁻" : (SUPERSCRIPTS[Number(sign)] ?? ""))).join("");
}

export function bytes(count: number): string {
  if (count >= 1e6) return `${digits(count / 1e6)} MB`;
  return count >= 1000 ? `${digits(count / 1000)} kB` : `${count.toFixed(0)} B`;
}

/** Count with its noun: "1 example", "24 examples". */
export function countText(count: number, noun: string): string {
  return `${count} ${noun}${count === 1 ? "" : "s"}`;
}
