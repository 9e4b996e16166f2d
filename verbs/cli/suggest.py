"""Command ``suggest``: where the next example of a verb would help most."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from verbs.cli.options import Json, VerbArgument, open_verb
from verbs.cli.output import out, plain, print_json

if TYPE_CHECKING:
    from verbs.proposal.suggest import Suggestion
    from verbs.verb import Verb

__all__ = ["suggest_command"]


def suggest_command(
    verb: VerbArgument,
    count: Annotated[int, typer.Option("-n", "--count", help="Number of suggestions, 1 to 50.")] = 5,
    picture: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="PNG", help="Draw the poses guessed there.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show where the next examples would help most, and show the poses guessed there.

    Example: [bold]adverb suggest reach -n 5 -o next.png[/]
    """
    import numpy as np

    from verbs.proposal.suggest import suggest

    loaded = open_verb(verb)
    found = suggest(loaded, count)
    if picture:
        _draw(loaded, found, picture)
    if as_json:
        print_json([_record(loaded, one) for one in found])
        return
    table = Table()
    for column in ("", *(adverb.name for adverb in loaded.adverbs), "expected", "gain", "support", "Σ|w|"):
        table.add_column(plain(column), justify="right")
    table.add_column("examples that it helps, left out", overflow="fold")
    for k, one in enumerate(found, start=1):
        near = f"{', '.join(one.helped)}: {np.degrees(one.helped_error):.1f}°"
        expected = f"{np.degrees(one.expected_error):.1f}°"
        table.add_row(str(k), *(f"{value:.3f}" for value in one.adverbs), expected, f"{100 * one.gain:.1f} %",
                      f"{one.support:.2f}", f"{one.weight_sum:.2f}", plain(near))  # fmt: skip
    out.print(table)
    out.print("expected: joint error to expect there now; gain: share of the errors, left out and expected, that "
              "the example removes, those above it made.", soft_wrap=True)  # fmt: skip
    if picture:
        out.print(f"poses → {plain(str(picture))}", soft_wrap=True)


def _draw(verb: Verb, found: list[Suggestion], path: Path) -> None:
    """A strip of the poses guessed at the suggestions, with the goals of positions."""
    import numpy as np

    from verbs.figures import canvas
    from verbs.figures.draw import draw_poses, points
    from verbs.figures.strips import view_of
    from verbs.kernels.measure import POSITION
    from verbs.proposal.suggest import guess_phase
    from verbs.runtime.evaluate import Evaluator

    canvas.require()
    evaluator, goals = Evaluator(verb), np.array([one.adverbs for one in found])
    poses = evaluator.pose(goals, phase=guess_phase(verb), plant=False)
    marks = list(evaluator.goal.points(goals)) if verb.measure.kind == POSITION else []
    labels = [", ".join(f"{adverb.name} {value:.2f}" for adverb, value in zip(verb.adverbs, one.adverbs, strict=True))
              for one in found]  # fmt: skip
    bodies = list(points(verb.skeleton, poses.root, poses.rotations))
    draw_poses(verb.skeleton, bodies, path, view=view_of(verb), columns=min(len(found), 8), labels=labels, marks=marks)


def _record(verb: Verb, one: Suggestion) -> dict[str, Any]:
    """A suggestion as JSON."""
    return {
        "adverbs": {adverb.name: float(value) for adverb, value in zip(verb.adverbs, one.adverbs, strict=True)},
        "expected_error_rad": one.expected_error,
        "gain": one.gain,
        "support": one.support,
        "weight_sum": one.weight_sum,
        "helped": list(one.helped),
        "helped_left_out_rad": one.helped_error,
        "positions": dict(zip(verb.skeleton.names, one.positions.round(5).tolist(), strict=True)),
    }
