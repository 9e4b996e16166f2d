"""Command ``map``, and the options of commands that map."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from verbs.cli.options import Json, open_verb
from verbs.cli.output import err, out, plain, print_json, progress

if TYPE_CHECKING:
    from verbs.mapping.mapper import Figures
    from verbs.mapping.report import Report

__all__ = ["GoalOption", "MapOption", "figures_text", "map_command"]

_TARGET = "vrm, unreal, mixamo, smpl, a mapping.toml, or a .glb, .gltf, .vrm, .bvh or .npz file"
MapOption = Annotated[str | None, typer.Option("--map", metavar="TARGET", help=f"Skeleton of the motion: {_TARGET}.")]
GoalOption = Annotated[
    str | None, typer.Option("--goal", help="Goal of the effector: scaled with the body, or world. [default: scaled]")
]


def map_command(
    target: Annotated[str, typer.Argument(metavar="TARGET", help=f"Skeleton: {_TARGET}.")],
    verb: Annotated[str, typer.Option("--verb", help="Verb whose skeleton is mapped.")] = "reach",
    goal: GoalOption = None,
    goals: Annotated[int, typer.Option(min=0, max=10_000, help="Motions of which figures are taken.")] = 27,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the mapping as a mapping.toml.")] = None,
    as_json: Json = False,
) -> None:
    """Print how the joints of a verb move another skeleton, and how well effector and feet keep their places.

    The figures are of whole motions at random goals inside the domain. A mapping.toml can be edited and given back.

    Example: [bold]adverb map hero.glb --verb reach -o mapping.toml[/]
    """
    from verbs.io.files import write_atomically
    from verbs.mapping.mapper import Mapper
    from verbs.mapping.mapping import open_mapping
    from verbs.mapping.plan import explicit_joints
    from verbs.mapping.presets import PRESETS
    from verbs.mapping.report import measure, rows_as_dicts
    from verbs.mapping.toml_writer import to_toml
    from verbs.runtime.evaluate import Evaluator

    mapping = open_mapping(target, goal=goal)
    for note in mapping.rig.notes:
        err.print(f"{plain(mapping.rig.name)}: {plain(note)}")
    evaluator = Evaluator(open_verb(verb))
    mapper = Mapper.of_verb(evaluator, mapping)
    report = None
    if goals:
        with progress() as bars:
            report = measure(mapper, evaluator, goals=goals, progress=bars)
    if output is not None:
        joints = explicit_joints(mapper.source.rig, mapping.rig, mapper.tables.rows)
        name = mapping.rig.name
        if mapping.rig.path is not None:
            name = os.path.relpath(mapping.rig.path, output.resolve().parent)
        write_atomically(output, to_toml(mapping, joints, name).encode())
        err.print(f"{plain(str(output))}: {len(joints)} joints of '{plain(name)}'{_hint(name, PRESETS)}")
    rows = rows_as_dicts(mapper)
    if as_json:
        record: dict[str, Any] = {
            "verb": evaluator.verb.name, "target": mapping.rig.name, "unit": mapping.rig.unit, "goal": mapping.goal,
            "scale": mapper.tables.scale, "joints": rows, "figures": None if report is None else report.as_dict(),
        }  # fmt: skip
        print_json(record)
        return
    out.print(_table(rows, f"{evaluator.verb.name} on {mapping.rig.name}"))
    moved = sum(row["source"] is not None for row in rows)
    out.print(f"{moved} of {len(rows)} joints move; lengths × {mapper.tables.scale:.3f}; unit {mapping.rig.unit}")
    if report is not None:
        out.print(_report_text(report, mapping.goal))


def _hint(name: str, presets: tuple[str, ...]) -> str:
    return "" if name in presets else "; keep both files together"


def _table(rows: list[dict[str, Any]], title: str) -> Table:
    table = Table("joint of the target", "moved by", "bone", "how", title=title, title_justify="left")
    for row in rows:
        source = row["source"] or "–"
        if row["second"]:
            source = f"{row['source']} – {row['second']}, {100 * row['share']:.0f} %"
        table.add_row(plain(row["target"]), plain(source), row["bone"], row["how"])
    return table


def _report_text(report: Report, goal: str) -> str:
    lines = [f"{report.goals} motions, median and worst:"]
    pairs = (
        (f"effector to its {goal} goal", report.median.effector_m, report.worst.effector_m),
        ("height of standing feet", report.median.foot_height_m, report.worst.foot_height_m),
        ("slide of standing feet", report.median.foot_slide_m, report.worst.foot_slide_m),
    )
    for name, median, worst in pairs:
        if median is not None and worst is not None:
            lines.append(f"  {name:<26} {_millimetres(median):>9}   {_millimetres(worst):>9}")
    if report.reached is not None and report.reached < report.goals:
        lines.append(f"  {report.goals - report.reached} of {report.goals} goals are out of reach by more than 1 mm")
    return "\n".join(lines)


def _millimetres(metres: float) -> str:
    return f"{1000.0 * metres:.1f} mm"


def figures_text(figures: Figures) -> str:
    """The figures of one motion in a line."""
    pairs = (("effector", figures.effector_m), ("foot height", figures.foot_height_m), ("slide", figures.foot_slide_m))
    return ", ".join(f"{name} {_millimetres(value)}" for name, value in pairs if value is not None)
