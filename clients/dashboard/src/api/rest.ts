/** REST client of the page: sends the key of this tab, and reports the progress of uploads. */

import { AdverbError, type Caller, Client, request, type Send, type Upload } from "adverb-client";
import type { Access } from "../access/access";
import { draftRest } from "../drafts/api";
import type { DraftRest } from "../drafts/types";
import { fileSender, type SendFile, withKey } from "./request";

export class Rest extends Client {
  /** Routes of drafts. */
  readonly drafts: DraftRest;
  private readonly sendFile: SendFile;

  /**
   * @param access the key of this tab; null sends none
   * @param onProblem called with every failed response, before it is thrown
   */
  constructor(base = "", access: Access | null = null, onProblem: (problem: AdverbError) => void = () => {}) {
    const send: Send = async (path, init) => {
      try {
        return await withKey(access, init?.signal, (key) => request(path, init, key));
      } catch (err) {
        if (err instanceof AdverbError && err.status > 0) onProblem(err);
        throw err;
      }
    };
    super(base, { send });
    this.sendFile = fileSender(access);
    this.drafts = draftRest(send, this.sendFile, base);
  }

  /** Upload with progress, 0 to 1. */
  uploadFile(
    content: Blob,
    progress?: (share: number) => void,
    signal?: AbortSignal,
    expected?: number,
  ): Promise<Upload> {
    return this.sendFile(`${this.base}/v1/verbs`, content, progress, signal, expected);
  }
}

/** The holder of a key; throws an `AdverbError` if the server refuses it. */
export function callerOf(key: string, base = ""): Promise<Caller> {
  return new Client(base, { key }).access();
}
