import { NeutralToneMapping, PCFShadowMap, WebGLRenderer } from "three";

/** WebGL 2 is unavailable. */
export class NoWebGL extends Error {
  override readonly name = "NoWebGL";
  constructor() {
    super(
      "This browser cannot show 3D graphics: WebGL 2 is unavailable. " +
        "Enable hardware acceleration or use another browser.",
    );
  }
}

/** Renderer with a transparent background on a canvas of its own; throws `NoWebGL`. */
export function rendererOf(detail: "high" | "low"): WebGLRenderer {
  const surface = document.createElement("canvas");
  const context = surface.getContext("webgl2", {
    antialias: detail === "high",
    alpha: true,
    powerPreference: "high-performance",
  });
  if (!context) throw new NoWebGL();
  Object.assign(surface.style, { display: "block", width: "100%", height: "100%", outlineOffset: "-2px" });
  surface.setAttribute("role", "img");
  surface.setAttribute("aria-label", "Character and goal");
  const renderer = new WebGLRenderer({ canvas: surface, context });
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = PCFShadowMap;
  renderer.toneMapping = NeutralToneMapping;
  renderer.setClearAlpha(0);
  return renderer;
}
