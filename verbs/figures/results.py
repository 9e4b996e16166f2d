"""The page of tables that goes with the pictures."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isnan

import numpy as np

from verbs.figures import motions as whole
from verbs.figures.flow import ABNORMAL, DRAWN, FPS, FRAMES, RAMP, WINDOWS, Flow
from verbs.figures.refining import Refinement, hybrid_errors
from verbs.figures.study import Study
from verbs.quality.foot_contact import GOALS, GOALS_SEED, Slides
from verbs.quality.report import Figures

__all__ = ["PRINTED", "page"]


@dataclass(frozen=True, slots=True)
class _Printed:
    """One row of seed 1's numbers: what it is called, what ours needs, and mean / max (%) by built-in verb."""

    name: str
    searches: int
    refined: bool
    numbers: Mapping[str, str]


def _by_verb(arm: str, board: str, reach: str) -> dict[str, str]:
    return {"arm3": arm, "board": board, "reach": reach}


PRINTED = (
    _Printed("raw basis", 0, False, _by_verb("6.86 / 14.125", "8.11 / 23.86", "5.27 / 8.98")),
    _Printed("one line search", 1, False, _by_verb("1.125 / 4.725", "3.9 / 11.9", "1.03 / 3.22")),
    _Printed("three line searches", 3, False, _by_verb("–", "–", "–")),
    _Printed("pseudo-examples", 0, True, _by_verb("2.39 / –", "0.25 / 0.69", "0.51 / 1.41")),
    _Printed("hybrid", 1, True, _by_verb("0.4 / –", "0.1 / 0.48", "0.053 / 0.96")),
)
"""Seed 1's text, sections 4.2 and 4.3; it does not say how many pseudo-examples these took."""


def page(
    refined: list[Refinement],
    studies: list[Study],
    moved: list[whole.Motions],
    flows: list[Flow],
    *,
    captured: bool,
    seconds: float,
) -> str:
    """Give the whole page as Markdown."""
    nodes = studies[0].section.inside.shape[0]
    parts = [
        _HEAD.format(machine=platform.machine(), python=platform.python_version(), numpy=np.__version__,
                     seconds=f"{seconds:.0f}"),
        _seed_1(refined),
        _SEED_2.format(what="verbs built from motion capture" if captured else _INSTEAD, nodes=nodes),
        *[_study(one) for one in studies],
        _ranking(studies, captured=captured),
        *[_flow(one) for one in flows],
        _moved(moved),
        _pictures(studies, flows, captured=captured),
    ]  # fmt: skip
    return "\n".join(part.strip("\n") + "\n" for part in parts)


_HEAD = """
# Results

Tables and pictures of both papers, made anew by `verbs.figures` in one run of {seconds} s (Python {python},
NumPy {numpy}, {machine}, one thread). *Seed 1*: Rose, Sloan, Cohen 2001. *Seed 2*: Feng, Huang, Kallmann, Shapiro
2012. Seeds are fixed, so that errors and κ are the same in every run; times are not, and belong to this machine.

An error is the distance between what was asked and what is reached. In % it is a share of the diagonal of the
examples' bounding box in the space of goals: metres for places and jumps, m/s for speeds, a turn rate of 1 rad/s
counting as 1 m/s.
"""

_INSTEAD = "the built-in verbs (no motion capture was given)"

_SEED_2 = """
## Seed 2: methods compared

On {what}. Each method gets the same points, the same slices and the same clamp at the
domain's edge. κ is the curvature of the weights (§4.1), which depends on its grid: here {nodes} × {nodes} nodes to a
slice. Slices lie along the axes of the chart: angle about the body, height and distance from its axis (radius) in a
cylinder chart, the way jumped to the left and forward in a planar one.

Precomputation counts solving the basis, or refining it, or drawing the pseudo-examples of `knn`. Time per query is
that of weights alone, in a batch of up to 256, the least of 7 runs. `perdof` is `rbf` solved for every degree of
freedom: its weights are the same, and what it costs more to pose is not in these columns.
"""


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    heads = list(heads)
    lines = [heads, ["---", *["---:"] * (len(heads) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _number(value: float, digits: int = 3) -> str:
    if isnan(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.{digits}g}"
    return f"{value:.0e}".replace("e-0", "e-")


def _seed_1(refined: list[Refinement]) -> str:
    counts = [max(one.bases) for one in refined]
    some = min(20, *counts)
    rows = []
    for printed in PRINTED:
        for pseudo in (some, counts[0]) if printed.refined else (0,):
            pairs = [hybrid_errors(one, points, pseudo, printed.searches) for one in refined
                     for points in (one.sought, one.check)]  # fmt: skip
            name = f"{printed.name}, {pseudo}" if pseudo else printed.name
            rows.append([name, *[f"{mean:.3g} / {worst:.3g}" for mean, worst in pairs],
                         *[printed.numbers[one.verb.name] for one in refined]])  # fmt: skip
    ours = [f"{one.verb.name}, {points}" for one in refined for points in ("table", "check")]
    heads = ["mean / max error, %", *ours, *[f"seed 1: {_SEED_1_NAMES[one.verb.name]}" for one in refined]]
    where = "".join(f"- **{one.verb.name}**: table: {one.text}. {one.size:.3f} m are 100 %; refining with "
                    f"{max(one.bases)} pseudo-examples took {one.seconds:.1f} s.\n" for one in refined)  # fmt: skip
    return f"{_SEED_1}\n{_table(heads, rows)}\n{where}\n{_seed_1_words(refined, counts[0])}"


_SEED_1_NAMES = {"arm3": "arm", "board": "board", "reach": "reach"}

_SEED_1 = """
## Seed 1: search, pseudo-examples, hybrid

The built-in planar arm (three links), the built-in board (a whole body drawing on a plane) and the built-in reach (a
whole body), beside the paper's printed numbers. The paper's examples are not published, nor is what its % are shares
of, nor how many pseudo-examples it took: its numbers are a band to compare with, not a target to hit. The table points
of arm and board are also those among which the worst was sought; the check points no refinement saw. The curves of
figure 14 are over the points among which the worst was sought, those of the hybrid over the table's. An error on the
board is a distance in space: what leaves the board counts, and no line search along the board can take that back.
"""


def _seed_1_words(refined: list[Refinement], most: int) -> str:
    lines = []
    for one in refined:
        ends = {rule: curve[-1] for rule, curve in one.curves.items()}
        local, everywhere = ends["local"], ends["global"]
        lines.append(
            f"- Local radii against global ones on {one.verb.name}: {local[1]:.3g} / {local[2]:.3g} % with "
            f"{local[0]:.0f} pseudo-examples, {everywhere[1]:.3g} / {everywhere[2]:.3g} % with {everywhere[0]:.0f}."
        )
    for printed in PRINTED:
        found = [_against(one, printed, printed.numbers[one.verb.name], most) for one in refined]
        lines += [f"- {printed.name.capitalize()}: {'; '.join(filter(None, found))}."] if any(found) else []
    return "\n".join(lines) + "\n"


def _against(one: Refinement, printed: _Printed, numbers: str, most: int) -> str:
    """Words for ours at the check points against printed ``numbers``, mean / max; empty where none are printed."""
    ours = hybrid_errors(one, one.check, most if printed.refined else 0, printed.searches)
    parts = [
        f"{word} {value:.3g} % {'better' if value < float(theirs) else 'worse'} than {theirs} %"
        for word, value, theirs in zip(("mean", "max"), ours, numbers.split(" / "), strict=False)
        if theirs != "–"
    ]
    return (
        f"{one.verb.name}{f' with {most} pseudo-examples' if printed.refined else ''}: {', '.join(parts)}"
        if parts
        else ""
    )


def _study(one: Study) -> str:
    first, unit = next(iter(one.figures.values())), one.verb.measure.unit
    heads = ["method", f"error mean ({unit})", f"max ({unit})", "mean (%)", "max (%)", "κ mean", "κ max",
             "Σ\\|w\\| max", "precompute (s)", "query (µs)"]  # fmt: skip
    rows = [_row(row) for row in one.figures.values()]
    return (
        f"### {one.verb.name}\n\n{len(one.verb.examples)} examples; {one.size:.3f} {unit} are 100 %. "
        f"Error: {first.domain}. κ: {first.grid}. `refined` and `hybrid` hold {one.pseudo} "
        f"pseudo-examples.\n\n{_table(heads, rows)}"
    )


def _row(row: Figures) -> list[str]:
    numbers = (row.error_mean_m, row.error_max_m, row.error_mean_pct, row.error_max_pct, row.smoothness,
               row.smoothness_max, row.weight_sum_max, row.precompute_s, row.query_us)  # fmt: skip
    return [f"`{row.method}`", *[_number(value) for value in numbers]]


_FOUR = ("inverse", "knn", "barycentric", "rbf")


def _ranking(studies: list[Study], *, captured: bool) -> str:
    """Say who ranks where, and where ``corrected`` is behind."""
    rows = []
    for one in studies:
        known = [name for name in _FOUR if name in one.figures]
        exact = sorted(known, key=lambda name: one.figures[name].error_mean_m)
        smooth = sorted(known, key=lambda name: one.figures[name].smoothness)
        rows.append([one.verb.name, " < ".join(exact), " < ".join(smooth), _behind(one)])
    heads = ["verb", "mean error, least first", "mean κ, least first", "where `corrected` is not the best"]
    counts = ", ".join(f"{one.verb.name} {len(one.verb.examples)} (paper {PAPER_COUNTS[one.verb.name]})"
                       for one in studies if one.verb.name in PAPER_COUNTS)  # fmt: skip
    rough = sum(max(_FOUR, key=lambda name: one.figures[name].smoothness) == "knn" for one in studies)
    against = _AGAINST.format(counts=counts, rough=rough, all=len(studies)) if captured else ""
    return f"### Rankings\n\n{_RANKED}\n{_table(heads, rows)}\n{against}"


_RANKED = """The paper's table of numbers (its figure 5) is an image of which we have no text: only its ranking can be
compared. By its sections 5 and 6 the order of error is `inverse` < `knn` < `barycentric` < `rbf`, and the order of κ
`rbf` < `barycentric` < `knn` < `inverse`. Ours, of the same four:
"""

_AGAINST = """The paper has `inverse` as the roughest; of ours it is `knn` on {rough} of {all} verbs. Jumps are linear
in their weights, so that what reproduces planes is exact there up to rounding, and the order of `barycentric` and `rbf`
on them means nothing. The sets of examples differ: {counts}.
"""

PAPER_COUNTS = {"reach": 24, "punch": 20, "kick": 20, "jump": 20, "locomotion": 20}
"""Examples of seed 2, its figure 1."""

_ROUNDING_PCT = 1e-6


def _behind(one: Study) -> str:
    """Fields of a table in which another method beats ``corrected``; errors at rounding count as equal."""
    ours = one.figures.get("corrected")
    if ours is None:
        return "–"
    found = []
    for field, word in (("error_mean_pct", "error"), ("smoothness", "κ"), ("weight_sum_max", "Σ\\|w\\|"),
                        ("query_us", "query")):  # fmt: skip
        floor = _ROUNDING_PCT if field == "error_mean_pct" else 0.0
        rows = [row for row in one.figures.values() if row.method != "perdof"]  # its weights are those of rbf
        best = min(rows, key=lambda row: getattr(row, field))
        if max(getattr(ours, field), floor) > max(getattr(best, field), floor):
            found.append(f"{word} {_number(getattr(ours, field))} (`{best.method}` {_number(getattr(best, field))})")
    return "; ".join(found) or "nowhere"


def _flow(one: Flow) -> str:
    rows = [
        [f"`{name}`", *[f"{share:.2f}" for share in shares], f"{one.faster[name]:.2f}", f"{one.largest[name]:.1f}"]
        for name, shares in one.shares.items()
    ]
    heads = ["method", *[f"off, window {window} (%)" for window in WINDOWS], f"faster, window {DRAWN} (%)",
             f"worst ratio, window {DRAWN}"]  # fmt: skip
    words = _FLOW.format(frames=FRAMES, fps=f"{FPS:g}", low=RAMP[0][1], high=RAMP[1][1], begin=RAMP[0][0],
                         end=RAMP[1][0], limit=ABNORMAL)  # fmt: skip
    most = max(one.faster, key=lambda name: one.faster[name])
    return f"{words}\n{_table(heads, rows)}\n{_FLOW_READ.format(most=most)}"


_FLOW = """
### Motion vector flow

Locomotion, {frames} frames at {fps} fps, forward speed {low:g} to {high:g} m/s between {begin:g} and {end:g} s, the
other adverbs 0. The length of every joint's movement between two frames is compared with the mean of its neighbours in
a sliding window (frames, without the vector itself); 5 mm are added to both. A vector is off where it is more than
{limit:g} times longer or shorter.
"""

_FLOW_READ = """Feet that land and lift slow down abruptly in any gait, and the more so the longer the window: that part
all methods share. Speed-ups are what jitter looks like, and of those `{most}` has the most. Where others differ by
tenths of a percent, or change places with the window, no order is claimed.
"""


def _moved(moved: list[whole.Motions]) -> str:
    kinds = (whole.EXAMPLES, *whole.METHODS)
    names = [whole.EXAMPLES, *[f"`{method}`" for method in whole.METHODS]]
    standing = [one for one in moved if one.slides[whole.EXAMPLES].stances]
    slides = [[one.verb.name, *[_slide(one.slides[kind]) for kind in kinds]] for one in standing]
    peaks = [[one.verb.name, *[_peak(one.peaks[kind]) for kind in kinds]] for one in moved]
    feet = _FEET.format(count=GOALS, seed=GOALS_SEED)
    return f"{feet}\n{_table(['verb', *names], slides)}\n{_more(standing)}{_PEAKS}\n{_table(['verb', *names], peaks)}"


def _slide(slides: Slides) -> str:
    return f"{1000 * slides.median_m:.1f} / {1000 * slides.p90_m:.1f} / {1000 * slides.max_m:.1f}"


def _peak(peaks: whole.Peaks) -> str:
    return (
        f"{peaks.acceleration_median_m_s2:.1f} ({peaks.acceleration_max_m_s2:.0f}), "
        f"{peaks.speed_median_m_s:.1f} ({peaks.speed_max_m_s:.1f})"
    )


def _more(moved: list[whole.Motions]) -> str:
    """Say how much more than the examples blends slide; nothing where the examples hardly do."""
    lines = []
    for method in whole.METHODS:
        ratios = [one.slides[method].median_m / one.slides[whole.EXAMPLES].median_m for one in moved
                  if one.slides[whole.EXAMPLES].median_m > _PLANTED_M]  # fmt: skip
        if ratios:
            lines.append(f"`{method}` {min(ratios):.1f} to {max(ratios):.1f}")
    return f"Medians of blends over those of the examples: {', '.join(lines)} times.\n" if lines else ""


_PLANTED_M = 1e-3

_FEET = """
## Foot slide

How far toes slide over the ground while they stand: the largest distance from the mean place of a stance, in mm,
median / 90th percentile / largest of all stances. Blends are the whole motions of {count} random goals in the domain
(seed {seed}), the same for every method; a toe stands in them where the examples' contacts, blended by the same weights
over canonical time, are above one half. Nothing plants feet here. Runs have fewer stances than steps, because their
feet hardly slow down.
"""

_PEAKS = """
### Peaks of whole motions

The same motions at 60 Hz: the largest acceleration of any joint (m/s²), then the largest speed of the effector (m/s);
of each the median of the motions, and in brackets the largest.
"""


def _pictures(studies: list[Study], flows: list[Flow], *, captured: bool) -> str:
    names = [*_PICTURES[:5], ("seed1_fig15_18_reach", "Seed 1, figures 15–18: the built-in reach along its adverbs")]
    if captured:
        names += [(f"seed1_fig15_18_{one.verb.name}_captured", f"Seed 1, figures 15–18: captured {one.verb.name}, rows "
                   "along the axes of its chart") for one in studies]  # fmt: skip
    names += _PICTURES[5:]
    if flows:
        names.append(("seed2_fig6_flow", "Seed 2, figure 6: motion vector flow of a walk that becomes a jog"))
    return "## Pictures\n\n" + "\n".join(f"![{words}](figures/{name}.png)\n" for name, words in names)


_PICTURES = (
    ("seed1_fig4_5_cardinal", "Seed 1, figures 4 and 5: cardinal basis of three examples on a line"),
    ("seed1_fig6_9_11_arm", "Seed 1, figures 6, 9 and 11: where a grid of adverbs arrives, planar arm"),
    ("seed1_fig7_10_12_board", "Seed 1, figures 7, 10 and 12: a grid of adverbs and a drawing, built-in board"),
    ("seed1_fig8_13_reach", "Seed 1, figures 8 and 13: a plane of adverbs, built-in reach"),
    ("seed1_fig14_pseudo_examples", "Seed 1, figure 14: error against the number of pseudo-examples"),
    ("seed2_fig2_domains", "Seed 2, figure 2: domains"),
    ("seed2_fig3_accuracy", "Seed 2, figure 3: error over a slice"),
    ("seed2_fig4_smoothness", "Seed 2, figure 4: κ over a slice"),
    ("seed2_fig5_comparison", "Seed 2, figure 5: methods compared"),
    ("seed2_fig7_overview", "Seed 2, figure 7: accuracy against smoothness"),
)
