"""Commands ``pose`` and ``export``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from verbs.cli.map import GoalOption, MapOption, figures_text
from verbs.cli.options import At, Json, MethodOption, Plant, VerbArgument, open_verb, parse_at
from verbs.cli.output import err, out, plain, print_json
from verbs.errors import RequestError
from verbs.units import quantity

if TYPE_CHECKING:
    from verbs.motion import Motion
    from verbs.runtime.evaluate import Evaluator, Poses

__all__ = ["FORMATS", "export_command", "pose_command"]

FORMATS = ("bvh", "glb", "vrma", "npz", "usd")
"""Formats of exported motions, by the ending of their files."""


def pose_command(
    verb: VerbArgument,
    at: At,
    phase: Annotated[float | None, typer.Option(help="Canonical time, 0 to 1.")] = None,
    time: Annotated[float | None, typer.Option(help="Seconds from the start.")] = None,
    method: MethodOption = None,
    plant: Plant = True,
    as_json: Json = False,
) -> None:
    """Print the pose of a verb at some adverbs, its error, and how well the examples support it.

    Support is 1 at an example, and 0.5 where an answer is as uncertain as an example predicted from the others.

    Example: [bold]adverb pose reach --at x=-0.3,y=1.2,z=0.4 --phase 0.5[/]
    """
    from verbs.runtime import describe
    from verbs.runtime.evaluate import Evaluator

    evaluator = Evaluator(open_verb(verb))
    poses = evaluator.pose(parse_at(at), phase=phase, time_s=time, method=method, plant=plant)
    record = describe.pose_record(evaluator, poses, 0)
    if as_json:
        print_json(record)
        return
    table = Table("joint", "x", "y", "z", "w", title="local rotations", title_justify="left")
    for name, rotation in zip(evaluator.verb.skeleton.names, poses.rotations[0], strict=True):
        table.add_row(name, *(f"{value:+.4f}" for value in rotation))
    out.print(table)
    unit = evaluator.verb.measure.unit
    error = "none (style only)" if record["error"] is None else quantity(record["error"], unit)
    units = {adverb.name: adverb.unit.replace("none", "") for adverb in evaluator.verb.adverbs}
    measured = ", ".join(f"{name} {value:.4f} {units[name]}".rstrip() for name, value in record["measured"].items())
    out.print(
        f"phase {record['phase']:.4f}, {record['time']:.3f} of {record['duration']:.3f} s, method {record['method']}"
    )
    clamped = "; clamped" if record["clamped"] else ""
    out.print(f"measured {measured or 'nothing'}; error {error}; support {record['support']:.2f}{clamped}")


def _checked_format(output: Path, form: str | None) -> str:
    """Format of a file; refuses one that cannot be written, or whose ending and format are not supported together."""
    ending = output.suffix.removeprefix(".").lower()
    chosen = form or {"usda": "usd"}.get(ending, ending) or FORMATS[0]
    if chosen not in FORMATS:
        raise RequestError(f"format '{chosen}' is not supported; known: {', '.join(FORMATS)}")
    if ending not in ("", chosen) and (ending, chosen) != ("usda", "usd"):
        raise RequestError(
            f"{output.name} ends in .{ending}, but --format is {chosen}; leave one out. Known: {', '.join(FORMATS)}"
        )
    if output.is_dir():
        raise RequestError(f"{output} is a folder; name a file to write")
    return chosen


def export_command(
    verb: VerbArgument,
    at: At,
    output: Annotated[Path, typer.Option("-o", "--output", help="File to write.")],
    form: Annotated[
        str | None,
        typer.Option("--format", help=f"One of {', '.join(FORMATS)}. [default: the ending of the file]"),
    ] = None,
    fps: Annotated[float, typer.Option(min=1, max=240, help="Frames per second.")] = 30.0,
    cycles: Annotated[int, typer.Option(min=1, max=100, help="Cycles of a looping verb.")] = 1,
    method: MethodOption = None,
    plant: Plant = True,
    mannequin: Annotated[
        bool, typer.Option("--mannequin/--no-mannequin", help="Add a simple body to the skeleton of a glb file.")
    ] = True,
    target: MapOption = None,
    mapped_goal: GoalOption = None,
) -> None:
    """Write a whole motion to a file in metres: BVH, glTF (glb), VRM animation (vrma), NumPy (npz) or USD.

    A VRM animation needs a humanoid skeleton. USD needs usd-core, which the extra "usd" installs. With --map the
    motion is on another skeleton; a .glb of a .glb or .vrm target is that file with the motion added.

    Example: [bold]adverb export reach --at x=-0.3,y=1.2,z=0.4 -o reach.glb[/]
    """
    from verbs.io import motion_files
    from verbs.io.files import write_atomically
    from verbs.runtime import sequence
    from verbs.runtime.evaluate import Evaluator

    chosen = _checked_format(output, form)
    evaluator = Evaluator(open_verb(verb))
    goal = parse_at(at)
    poses = sequence.sequence(evaluator, evaluator.adverbs(goal), fps, cycles=cycles, method=method, plant=plant)
    name = evaluator.verb.name
    extras = {"verb": name, "adverbs": goal}
    if target is None:
        if mapped_goal is not None:
            raise RequestError("--goal is for a motion on another skeleton; give --map too")
        motion, figures = sequence.to_motion(evaluator, poses, fps), ""
        content = motion_files.dump(motion, chosen, mannequin=mannequin, name=name, extras=extras)
    else:
        motion, content, figures = _mapped(evaluator, poses, fps, (target, mapped_goal), chosen, mannequin, extras)
    write_atomically(output, content)
    err.print(
        f"{plain(str(output))}: {len(motion)} frames at {fps:g} fps, {poses.duration_s[0] * cycles:.2f} s{figures}"
    )


def _mapped(
    evaluator: Evaluator, poses: Poses, fps: float, target: tuple[str, str | None], form: str, mannequin: bool,
    extras: dict[str, Any],
) -> tuple[Motion, bytes, str]:  # fmt: skip
    """A motion on another skeleton, its file, and its figures as text."""
    from verbs.io import motion_files
    from verbs.mapping.embedding import embeddable, embedded
    from verbs.mapping.mapper import Mapper
    from verbs.mapping.mapping import open_mapping
    from verbs.mapping.vrm import humanoid_of

    mapper = Mapper.of_verb(evaluator, open_mapping(target[0], goal=target[1]))
    rig = mapper.mapping.rig
    motion, figures = mapper.sequence(evaluator, poses, fps)
    name = evaluator.verb.name
    extras = extras | {"map": rig.name, "figures": figures.as_dict()}
    note = figures_text(figures)
    if form == "glb" and embeddable(rig):
        content = embedded(rig, motion, name=name, extras=extras)
    else:
        human = humanoid_of(rig)
        content = motion_files.dump(motion, form, mannequin=mannequin, name=name, extras=extras, humanoid=human)
        if form == "glb" and rig.nodes:
            note += "; without the mesh of the target, whose file does not hold all its data plainly"
    return motion, content, f"; {note}"
