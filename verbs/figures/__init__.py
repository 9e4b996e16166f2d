"""Figures and tables of both papers, generated from runs with fixed seeds.

Source: Rose, Sloan, Cohen 2001 (seed 1); Feng, Huang, Kallmann, Shapiro 2012 (seed 2).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from verbs import library
from verbs.figures import canvas, charts, flow, grids, maps, motion_table, refined_table, results, rows
from verbs.figures.cardinal import draw_cardinal
from verbs.figures.motions import motions
from verbs.figures.refining import Refinement, refinement
from verbs.figures.study import Progress, Study, found, study

__all__ = ["figures"]

BUILT_IN = ("arm3", "board", "reach")
"""Verbs of seed 1's tables, in its order."""


def figures(out: Path, *, data: Path | None, quick: bool = False, progress: Progress | None = None) -> list[Path]:
    """Write all figures, and the page of tables.

    Parameters
    ----------
    out : Path
        Folder for ``results.md`` and ``figures/*.png``.
    data : Path or None
        Folder of captures, one folder per verb: reach, punch, kick, jump, locomotion, those that exist. Without
        any of them the built-in verbs are used.
    quick : bool
        Built-in verbs, coarse grids and few pseudo-examples only, as a test of the generator.
    progress : callable, optional
        Called with (stage, done, total).

    Returns
    -------
    paths : list of Path
        The files written, ``results.md`` last.

    Raises
    ------
    VerbError
        If matplotlib is missing.
    """
    canvas.require()
    report = progress or (lambda stage, done, total: None)
    started, folder = time.perf_counter(), out / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    refined = [refinement(library.load(name), quick=quick, progress=report) for name in BUILT_IN]
    paths = _seed_1(folder, refined, report)
    sources = [] if data is None or quick else found(data)
    studies = [study(verb, quick=quick, progress=report) for verb in sources or [one.verb for one in refined]]
    paths += _seed_2(folder, studies, report)
    paths += rows.draw(folder, [refined[-1].verb, *sources], report)
    flows = [flow.draw(folder / "seed2_fig6_flow.png", verb, report) for verb in sources if verb.name == "locomotion"]
    paths += [one.path for one in flows]
    moved = [motions(one.verb, report) for one in studies]
    calmer = refined_table.refined(sources or [refined[-1].verb], report, quick=quick)
    compared = motion_table.comparisons(sources, report, quick=quick)
    seconds = time.perf_counter() - started
    text = results.page(refined, studies, moved, flows, compared, calmer, captured=bool(sources), seconds=seconds)
    (out / "results.md").write_text(text, encoding="utf-8")
    return [*paths, out / "results.md"]


def _seed_1(folder: Path, refined: list[Refinement], report: Progress) -> list[Path]:
    arm, drawing, reach = refined
    pictures: list[Callable[[], Path]] = [
        lambda: draw_cardinal(folder / "seed1_fig4_5_cardinal.png"),
        lambda: grids.draw_arm(folder / "seed1_fig6_9_11_arm.png", arm),
        lambda: grids.draw_board(folder / "seed1_fig7_10_12_board.png", drawing),
        lambda: grids.draw_reach(folder / "seed1_fig8_13_reach.png", reach),
        lambda: charts.draw_curves(folder / "seed1_fig14_pseudo_examples.png", refined),
    ]
    paths = []
    for k, draw in enumerate(pictures):
        report("seed 1", k, len(pictures))
        paths.append(draw())
    report("seed 1", len(pictures), len(pictures))
    return paths


def _seed_2(folder: Path, studies: list[Study], report: Progress) -> list[Path]:
    paths = [
        maps.draw_domains(folder / "seed2_fig2_domains.png", [one.verb for one in studies]),
        maps.draw_errors(folder / "seed2_fig3_accuracy.png", studies),
        maps.draw_curvatures(folder / "seed2_fig4_smoothness.png", studies),
        charts.draw_bars(folder / "seed2_fig5_comparison.png", studies),
        charts.draw_overview(folder / "seed2_fig7_overview.png", studies),
    ]
    report("seed 2", len(paths), len(paths))
    return paths
