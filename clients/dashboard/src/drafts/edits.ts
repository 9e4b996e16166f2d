/** Changes of a draft: joined while a request runs, and applied to the displayed draft before the answer. */

import type { Clip, ClipEdit, Draft, DraftEdit } from "./types";

/** Evidence of a keytime that was given, as the server states it. */
export const SET = "set";

/** One edit that has the effect of `first` and then `second`. */
export function joined(first: DraftEdit, second: DraftEdit): DraftEdit {
  const names = [...new Set([...Object.keys(first.clips ?? {}), ...Object.keys(second.clips ?? {})])];
  if (names.length === 0) return { ...first, ...second };
  const clips = Object.fromEntries(names.map((name) => [name, joinedClip(first.clips?.[name], second.clips?.[name])]));
  return { ...first, ...second, clips };
}

function joinedClip(first: ClipEdit = {}, second: ClipEdit = {}): ClipEdit {
  const later = new Set(second.mends?.map(({ index }) => index));
  const mends = [...(first.mends ?? []).filter(({ index }) => !later.has(index)), ...(second.mends ?? [])];
  const adverbs = { ...first.adverbs, ...second.adverbs };
  return {
    ...first,
    ...second,
    ...(mends.length > 0 && { mends }),
    ...(Object.keys(adverbs).length > 0 && { adverbs }),
  };
}

/** The draft as it is displayed while an edit waits for its answer. */
export function applied(draft: Draft, edit: DraftEdit | null): Draft {
  if (!edit) return draft;
  const { clips, adverbs, propose: _, ...plain } = edit;
  return {
    ...draft,
    ...plain,
    adverbs: adverbs ? draft.adverbs.map((adverb, k) => ({ ...adverb, ...adverbs[k] })) : draft.adverbs,
    clips: clips ? draft.clips.map((clip) => appliedClip(clip, clips[clip.name])) : draft.clips,
  };
}

/** Confidence and evidence of keytimes of which some were changed. */
function given({ keytimes, confidence, evidence }: Clip, times: readonly number[]): Partial<Clip> {
  const same = times.map((time, k) => Math.abs(time - (keytimes?.[k] ?? Number.NaN)) < 1e-6);
  return {
    confidence: same.map((kept, k) => (kept ? (confidence?.[k] ?? 1) : 1)),
    evidence: same.map((kept, k) => (kept ? (evidence?.[k] ?? SET) : SET)),
  };
}

function appliedClip(clip: Clip, edit: ClipEdit | undefined): Clip {
  if (!edit) return clip;
  const apply = new Map(edit.mends?.map((mend) => [mend.index, mend.apply]));
  return {
    ...clip,
    keytimes: edit.keytimes ?? clip.keytimes,
    set: edit.keytimes ? true : edit.keytimes === null ? false : clip.set,
    ...(edit.keytimes && given(clip, edit.keytimes)),
    excluded: edit.excluded ?? clip.excluded,
    adverbs: edit.adverbs ? { ...clip.adverbs, ...edit.adverbs } : clip.adverbs,
    mends: clip.mends.map((mend) => ({ ...mend, apply: apply.get(mend.index) ?? mend.apply })),
  };
}
