/** Numbers with as many digits as they are worth. */

/** How a quantity is written: `factor` of these to one of the server's. */
export interface Unit {
  text: string;
  factor: number;
}

const METRES: Record<string, string> = { m: "", "m/s": "/s" };

/** The unit in which errors up to `most` read well. */
export function errorUnit(unit: string, most: number): Unit {
  const per = METRES[unit];
  if (per === undefined) return { text: unit, factor: 1 };
  return most >= 0.1 ? { text: `cm${per}`, factor: 100 } : { text: `mm${per}`, factor: 1000 };
}

/** Three digits; what is too small to matter is 0. */
export function digits(value: number, least = 0.005): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size < least) return "0";
  const text = size >= 100 ? size.toFixed(0) : String(Number(size.toPrecision(3)));
  return value < 0 ? `−${text}` : text;
}

const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/** κ runs over many decades: two digits, and powers of ten where it is small. */
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

/** A count with its noun: "1 example", "24 examples". */
export function counted(count: number, noun: string): string {
  return `${count} ${noun}${count === 1 ? "" : "s"}`;
}
