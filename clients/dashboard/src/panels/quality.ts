/** Where the verb is right and wrong, and what makes it better. */

import type { App } from "../types";
import { Life } from "./parts/disposables";
import { Maps } from "./parts/quality_maps";
import { Refinements } from "./parts/refinements";

export function mount(host: HTMLElement, app: App): () => void {
  const life = new Life();
  host.append(new Maps(app, life).element, new Refinements(app, life).element);
  return () => life.end();
}
