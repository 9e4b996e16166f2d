/** Downloads with the key of this tab, which a link cannot send. */

import { textOf } from "../app";
import type { App } from "../types";
import { h } from "./dom";

/** Save a path of the server as a file; returns the problem, or an empty text. */
export async function download({ rest }: App, path: string, name: string): Promise<string> {
  try {
    saveAs(await rest.download(path), name);
    return "";
  } catch (err) {
    return textOf(err);
  }
}

/** Save content as a file of the browser's downloads. */
export function saveAs(content: Blob, name: string): void {
  const href = URL.createObjectURL(content);
  h("a", { href, download: name }).click();
  URL.revokeObjectURL(href);
}
