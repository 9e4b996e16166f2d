"""Seed 2, figure 6: motion vector flow of a walk that becomes a jog."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.figures import canvas
from verbs.figures.study import Progress
from verbs.runtime import sequence
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb

__all__ = ["ABNORMAL", "DRAWN", "FPS", "FRAMES", "RAMP", "WINDOWS", "Flow", "abnormal", "draw", "measured", "walk"]

FRAMES, FPS = 150, 30.0
RAMP = ((0.5, 0.85), (4.5, 3.0))
"""Seconds and forward speeds (m/s): from a slow walk to a jog, steady before and after; the other adverbs stay 0."""

WINDOWS = (3, 5, 7)
"""Frames of the sliding window whose mean a vector's length is compared with; the vector itself does not count."""

DRAWN = 5
"""The window of the picture."""

ABNORMAL = 1.5
"""A vector is abnormal if it is longer or shorter than the mean of its neighbours by more than this factor."""

FLOOR_M = 0.005
"""Added to both lengths: a standing foot moves by less than a millimetre, where ratios are meaningless."""

_STICK_EVERY = 15


@dataclass(frozen=True, slots=True, eq=False)
class Flow:
    """The figure, and the share of abnormal vectors.

    Parameters
    ----------
    path : Path
    shares : mapping of str to tuple of float
        By method: share of abnormal vectors (%) for each of :data:`WINDOWS`.
    faster, largest : mapping of str to float
        By method: share of abnormal speed-ups alone (%), and the largest ratio either way, for the drawn window.
    """

    path: Path
    shares: Mapping[str, tuple[float, ...]]
    faster: Mapping[str, float]
    largest: Mapping[str, float]


def walk(verb: Verb, method: str, *, margin: int = 0) -> F64:
    """Joint positions (150 + 2 · margin, J, 3) of the transition, with frames before and after it."""
    evaluator = Evaluator(verb)
    rows = np.zeros((len(RAMP), len(verb.adverbs)))
    rows[:, verb.adverb_index("forward_speed")] = [speed for _, speed in RAMP]
    times = np.array([time_s for time_s, _ in RAMP]) + margin / FPS
    poses = sequence.tracked(evaluator, times, rows, FPS, cycles=12, method=method)
    return evaluator.positions(poses)[1][: FRAMES + 2 * margin]


def abnormal(positions: F64, window: int) -> F64:
    """Log ratio (F - window, J) of each vector's length to the mean of its neighbours in time.

    The first and the last vectors, whose window is not whole, are left out.
    """
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=-1) + FLOOR_M
    whole = len(lengths) - window + 1
    inner = lengths[window // 2 : window // 2 + whole]
    around = sum(lengths[k : k + whole] for k in range(window)) - inner
    return np.asarray(np.log(inner * (window - 1) / around))


def measured(verb: Verb, method: str) -> tuple[F64, dict[int, F64]]:
    """Joint positions (150, J, 3) of the transition, and log ratios (149, J) of its vectors by window."""
    most = max(WINDOWS) // 2
    positions = walk(verb, method, margin=most)
    cuts = {window: most - window // 2 for window in WINDOWS}
    ratios = {window: abnormal(positions[cut : len(positions) - cut], window) for window, cut in cuts.items()}
    return positions[most:-most], ratios


def draw(path: Path, verb: Verb, progress: Progress) -> Flow:
    """Draw the flow of every shown method, one below the other, and count abnormal vectors."""
    title = (
        f"Motion vector flow, {FRAMES} frames at {FPS:g} fps, {RAMP[0][1]:g} to {RAMP[-1][1]:g} m/s (seed 2, figure 6)"
    )
    figure = canvas.canvas(11, 10.4, title=title)
    panels = figure.subplots(len(canvas.SHOWN), 1, sharex=True, sharey=True)
    shares, faster, largest, lines = {}, {}, {}, None
    for k, (axes, method) in enumerate(zip(panels, canvas.SHOWN, strict=True)):
        progress("flow", k, len(canvas.SHOWN))
        positions, ratios = measured(verb, method)
        limit, drawn = np.log(ABNORMAL), ratios[DRAWN]
        shares[method] = tuple(float(100 * np.mean(np.abs(ratios[window]) > limit)) for window in WINDOWS)
        faster[method] = float(100 * np.mean(drawn > limit))
        largest[method] = float(np.exp(np.abs(drawn).max()))
        lines = _panel(axes, verb, positions, drawn)
        found = f"{float(100 * np.mean(np.abs(drawn) > limit)):.2f} % of vectors, {faster[method]:.2f} % as speed-ups"
        axes.set_title(f"{method}: abnormal by more than {ABNORMAL:g} times: {found}", fontsize=10, loc="left")
        axes.set_ylabel("height (m)")
    panels[-1].set_xlabel("distance forward (m)")
    label = f"length of a vector against the mean of its {DRAWN - 1} neighbours in time"
    bar = figure.colorbar(lines, ax=list(panels), label=label, extend="both", aspect=40,
                          pad=0.01)  # fmt: skip
    bar.set_ticks([np.log(ratio) for ratio in (0.5, 2 / 3, 1.0, 1.5, 2.0)], labels=["½", "⅔", "1", "1½", "2"])
    progress("flow", len(canvas.SHOWN), len(canvas.SHOWN))
    return Flow(canvas.save(figure, path, dpi=84), shares, faster, largest)


def _panel(axes: Any, verb: Verb, positions: F64, ratios: F64) -> Any:
    """Vectors from the side, the abnormal ones last and thick, with stick figures over them."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    flat = positions[..., [2, 1]]
    vectors = np.stack([flat[:-1], flat[1:]], axis=2).reshape(-1, 2, 2)
    values = ratios.ravel()
    order = np.argsort(np.abs(values))
    widths = np.where(np.abs(values[order]) > np.log(ABNORMAL), 2.2, 0.7)
    lines = LineCollection(list(vectors[order]), array=values[order], cmap="coolwarm", linewidths=widths,
                           norm=Normalize(-np.log(2.0), np.log(2.0)))  # fmt: skip
    axes.add_collection(lines)
    limbs = [(child, parent) for child, parent in enumerate(verb.skeleton.parents) if parent >= 0]
    for frame in range(0, len(flat), _STICK_EVERY):
        sticks = [flat[frame, list(pair)] for pair in limbs]
        axes.add_collection(LineCollection(sticks, colors="0.15", linewidths=0.9, zorder=3))
    axes.set_aspect("equal")
    axes.set(xlim=(-0.5, float(flat[..., 0].max()) + 0.7), ylim=(-0.08, 1.75))
    return lines
