"""Section of ``results.md`` with the figures of whole motions, of built-in and captured verbs."""

from __future__ import annotations

from collections.abc import Mapping

from verbs import library
from verbs.figures.study import Progress
from verbs.quality.motion import FIGURES, GOALS, GOALS_SEED, LOW_M, SKATE_M_S, Comparison, Figure, compare
from verbs.verb import Verb

__all__ = ["comparisons", "section"]

QUICK_GOALS = 4

_GROUPS = (
    ("Feet", FIGURES[:6]),
    ("Joints", FIGURES[6:8] + FIGURES[10:16]),
    ("Bodies, loops and balance", FIGURES[8:10] + FIGURES[16:]),
)

_HEAD = """
## Figures of motion

Whole motions at 60 Hz, of the examples / of the blends at {goals} random goals in the domain (seed {seed}) / of the
same blends with planted feet, where there are feet; by the verb's default method.
[math.md](math.md#figures-of-motion) defines each figure. A toe is low under {low:g} cm above its standing height, and
skates above {skate:g} m/s. – stands where a figure does not apply: no feet, no loop, no standard joint names, or a body
that never rests over its feet. `adverb measure VERB --motion` prints the same.
"""


def comparisons(captured: list[Verb], progress: Progress, *, quick: bool) -> dict[str, Comparison]:
    """Figures of all built-in verbs, and of captured ones, by the name that the table gives them."""
    known = {name: library.load(name) for name in library.names()}
    known |= {f"{verb.name}, captured": verb for verb in captured}
    goals = QUICK_GOALS if quick else GOALS
    return {name: compare(verb, goals=goals, progress=progress) for name, verb in known.items()}


def section(found: Mapping[str, Comparison]) -> str:
    """The section as Markdown."""
    goals = next(iter(found.values())).goals
    parts = [_HEAD.format(goals=goals, seed=GOALS_SEED, low=100 * LOW_M, skate=SKATE_M_S)]
    for title, figures in _GROUPS:
        heads = ["verb", *(f"{figure.name} ({figure.unit})" for figure in figures)]
        lines = [heads, ["---", *["---:"] * len(figures)]]
        lines += [[name, *(_cell(one, figure) for figure in figures)] for name, one in found.items()]
        parts.append(f"### {title}\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n")
    return "\n".join(part.strip("\n") + "\n" for part in parts)


def _cell(one: Comparison, figure: Figure) -> str:
    sides = (one.examples, one.blends) if one.planted is None else (one.examples, one.blends, one.planted)
    values = [side.values[figure.key] for side in sides]
    return (
        "–" if all(value is None for value in values) else " / ".join(_number(value, figure.factor) for value in values)
    )


def _number(value: float | None, factor: float) -> str:
    if value is None:
        return "–"
    scaled = factor * value
    return "0" if abs(scaled) < 5e-3 else f"{scaled:.3g}" if abs(scaled) < 1e3 else f"{scaled:.0f}"
