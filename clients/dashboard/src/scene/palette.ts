import { Color } from "three";

/** Colours of the scene; semantic ones come from the page's CSS variables. */
export interface Palette {
  readonly dark: boolean;
  readonly figure: Color;
  readonly other: Color;
  readonly accent: Color;
  readonly pseudo: Color;
  readonly example: Color;
  readonly line: Color;
  readonly sky: Color;
  readonly earth: Color;
  readonly shadow: number;
}

function variable(host: HTMLElement, name: string, otherwise: string): Color {
  const text = getComputedStyle(host).getPropertyValue(name).trim();
  const plain = /^(#[0-9a-f]{3,8}|rgb|hsl)/i.test(text) ? text : otherwise;
  return new Color().setStyle(plain);
}

export function paletteOf(host: HTMLElement, dark: boolean): Palette {
  return {
    dark,
    figure: new Color(dark ? "#c9ced6" : "#efede8"),
    other: new Color(dark ? "#e08a4a" : "#c8621f"),
    accent: variable(host, "--accent", dark ? "#5ab0ff" : "#0b6bcb"),
    pseudo: variable(host, "--warn", dark ? "#e3b341" : "#a86400"),
    example: new Color(dark ? "#eef2f7" : "#2f3a48"),
    line: new Color(dark ? "#8fa0b5" : "#566374"),
    sky: new Color(dark ? "#cfdcf0" : "#f4f8ff"),
    earth: new Color(dark ? "#2a2f38" : "#b9b2a6"),
    shadow: dark ? 0.5 : 0.26,
  };
}
