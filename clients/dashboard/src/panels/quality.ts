/** Quality tab: maps and refinements. */

import type { App } from "../types";
import { Disposables } from "./parts/disposables";
import { QualityMaps } from "./parts/quality_maps";
import { Refinements } from "./parts/refinements";

export function mount(host: HTMLElement, app: App): () => void {
  const disposables = new Disposables();
  host.append(new QualityMaps(app, disposables).element, new Refinements(app, disposables).element);
  return () => disposables.dispose();
}
