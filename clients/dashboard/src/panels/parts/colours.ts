/** Colours and scales of the quality maps. */

type Triple = readonly [number, number, number];

/** Colour stops (OKLCH): even lightness steps from dark violet through blue and green to light yellow. */
const STOPS: readonly Triple[] = [
  [0.33, 0.13, 305],
  [0.44, 0.11, 265],
  [0.555, 0.09, 215],
  [0.67, 0.115, 165],
  [0.785, 0.16, 130],
  [0.9, 0.17, 103],
];
const STEPS = 256;

/** Red, green and blue, 0–255, of 256 colours. */
export const PALETTE: Uint8ClampedArray = palette();

function palette(): Uint8ClampedArray {
  const table = new Uint8ClampedArray(STEPS * 3);
  for (let k = 0; k < STEPS; k++) table.set(rgb(between(k / (STEPS - 1))), 3 * k);
  return table;
}

function between(share: number): Triple {
  const at = share * (STOPS.length - 1);
  const k = Math.min(Math.floor(at), STOPS.length - 2);
  const [low, high] = [STOPS[k] as Triple, STOPS[k + 1] as Triple];
  const mix = (n: 0 | 1 | 2) => low[n] + (at - k) * (high[n] - low[n]);
  return [mix(0), mix(1), mix(2)];
}

/** OKLCH to sRGB. Source: Björn Ottosson, "A perceptual color space for image processing", 2020. */
function rgb([lightness, chroma, hue]: Triple): [number, number, number] {
  const angle = (hue * Math.PI) / 180;
  const [a, b] = [chroma * Math.cos(angle), chroma * Math.sin(angle)];
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  const linear = [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
  return linear.map((value) => 255 * gamma(value)) as [number, number, number];
}

function gamma(value: number): number {
  return value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
}

/** Palette index of a value in 0–1, clamped. */
export function indexOf(share: number): number {
  return Math.round(Math.min(Math.max(share, 0), 1) * (STEPS - 1));
}

/** CSS gradient of the palette, left to right. */
export function gradient(): string {
  const stops = Array.from({ length: 17 }, (_, k) => {
    const at = 3 * indexOf(k / 16);
    return `rgb(${PALETTE[at]} ${PALETTE[at + 1]} ${PALETTE[at + 2]})`;
  });
  return `linear-gradient(to right, ${stops.join()})`;
}

export interface Scale {
  /** Position of a value on the scale, 0–1 within its range. */
  at(value: number): number;
  ticks: readonly number[];
}

/** Linear scale from 0 to a round number of at least `most`. */
export function linearScale(most: number): Scale {
  const decade = 10 ** Math.floor(Math.log10(most));
  const high = ([1, 1.2, 1.6, 2, 3, 4, 6, 8, 10].find((step) => step * decade >= most * (1 - 1e-9)) ?? 10) * decade;
  return { at: (value) => value / high, ticks: [0, 1, 2, 3, 4].map((k) => (k * high) / 4) };
}

/** Scale of shares, 0–1. */
export const SHARES: Scale = { at: (value) => value, ticks: [0, 0.25, 0.5, 0.75, 1] };

const MOST_DECADES = 4;

/** Logarithmic scale in whole decades that covers all but the smallest 5 % of the values. */
export function logScale(values: readonly number[]): Scale {
  const known = values.filter((value) => value > 0).sort((a, b) => a - b);
  const most = known.at(-1) ?? 1;
  const least = known[Math.floor(0.05 * known.length)] ?? 0.1;
  const high = Math.ceil(Math.log10(most) - 1e-9);
  const low = Math.max(Math.min(Math.floor(Math.log10(least)), high - 1), high - MOST_DECADES);
  const ticks = Array.from({ length: high - low + 1 }, (_, k) => 10 ** (low + k));
  return { at: (value) => (value > 0 ? (Math.log10(value) - low) / (high - low) : 0), ticks };
}
