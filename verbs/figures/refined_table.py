"""Section of ``results.md`` with the figures of refinements for quality, before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from verbs import refine_quality
from verbs.figures.study import Progress
from verbs.refine_quality.judge import ROWS
from verbs.verb import Verb

__all__ = ["Refined", "refined", "section"]

SEED, OTHER_SEED = 1, 2


@dataclass(frozen=True, slots=True)
class Refined:
    """A refinement of one verb, judged on two sets of goals that it has not seen."""

    pseudo: int
    attempts: int
    compared: tuple[refine_quality.Comparison, ...]


def refined(verbs: list[Verb], progress: Progress, *, quick: bool) -> dict[str, Refined]:
    """Refine verbs for quality, and compare; a quick run inserts one pseudo-example."""
    rules = refine_quality.Rules(max_pseudo=1, samples=20, seed=SEED) if quick else refine_quality.Rules(seed=SEED)
    found = {}
    for k, verb in enumerate(verbs):
        progress("refinement for quality", k, len(verbs))
        *_, last = refine_quality.refine(verb, rules)
        new = refine_quality.with_basis(verb, last.basis, rules, last.mark)
        compared = tuple(refine_quality.compare(verb, new, seed) for seed in (SEED, OTHER_SEED)[: 2 - quick])
        found[verb.name] = Refined(last.pseudo, last.mark.number, compared)
    progress("refinement for quality", len(verbs), len(verbs))
    return found


_HEAD = """
## Refinement for quality

`adverb refine` inserts up to 8 pseudo-examples into the smooth basis of a verb, which stays exact
([math.md](math.md#refinement-for-quality)). Before → after by `corrected`, at 200 goals that the refinement has not
used; the second line of each figure is another set of 200. Slide is that of blends without planting. The last
rows have the shares of goals whose cost changes by more than a tenth, and the verdict of the rule by which a worker
publishes.
"""


def section(found: Mapping[str, Refined]) -> str:
    """The section as Markdown."""
    heads = ["", *(f"{name} ({one.pseudo} in {one.attempts})" for name, one in found.items())]
    lines = [heads, ["---", *["---:"] * len(found)]]
    for key, name, unit, factor in ROWS:
        title = f"{name} ({unit})" if unit else name
        cells = [[_pair(one, key, factor) for one in each.compared] for each in found.values()]
        lines.append([title.replace("|", "\\|"), *("<br>".join(cell) for cell in cells)])
    shares = [[f"{one.better_ratio:.0%} / {one.worse_ratio:.0%}" for one in each.compared] for each in found.values()]
    lines.append(["goals better / worse", *("<br>".join(cell) for cell in shares)])
    verdicts = [["better" if one.better else "not better" for one in each.compared] for each in found.values()]
    lines.append(["verdict", *("<br>".join(cell) for cell in verdicts)])
    return _HEAD + "\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _pair(one: refine_quality.Comparison, key: str, factor: float) -> str:
    before, after = getattr(one.now, key), getattr(one.new, key)
    return "–" if before is None or after is None else f"{factor * before:.3g} → {factor * after:.3g}"
