"""The command ``adverb``: build, inspect, ask, measure, refine and export verbs, and draw the papers' figures.

Results go to stdout, everything else to stderr. What computes is imported by the commands that need it: it takes
seconds, and `--help` none.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from verbs.errors import OutOfRange, RequestError, UnknownName, VerbError

if TYPE_CHECKING:
    from verbs.authoring.fit import Built
    from verbs.quality.report import Figures
    from verbs.verb import Verb

__all__ = ["app", "main", "run"]

app = typer.Typer(
    name="adverb",
    help="Example motions in, any motion in between out, with its measured error.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
)

err = Console(stderr=True, highlight=False)
out = Console(highlight=False, width=None if sys.stdout.isatty() else 120)  # files and pipes have no width of their own

VerbArgument = Annotated[str, typer.Argument(metavar="VERB", help="A built-in name, a .verb file, or a source folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
At = Annotated[str, typer.Option("--at", metavar="NAME=VALUE,…", help="Adverbs, e.g. x=-0.3,y=1.2,z=0.4.")]
METHODS = "rbf, perdof, search, refined, hybrid, barycentric, knn, inverse, corrected"
MethodOption = Annotated[str | None, typer.Option("--method", help=f"One of {METHODS}.")]


def main() -> None:
    """Run the command line; the service adds its own commands before it does."""
    run(app)


def run(application: typer.Typer) -> None:
    """Run an application: library errors become one message and exit code 1."""
    try:
        application()
    except VerbError as problem:
        err.print(f"[bold red]error:[/] {_plain(str(problem))}", soft_wrap=True)
        sys.exit(1)


def _plain(text: str) -> str:
    """Text in which square brackets are no markup."""
    return text.replace("[", "\\[")


def open_verb(name: str) -> Verb:
    """A verb by built-in name, ``.verb`` file or source folder."""
    from verbs import library
    from verbs.io import artifact

    path = Path(name)
    if name in library.names():
        return library.load(name)
    if path.is_dir():
        from verbs.authoring.fit import build

        with _progress() as say:
            return build(path, progress=say).verb
    if path.exists():
        return artifact.load(path)
    raise UnknownName("verb", name, (*library.names(), "a .verb file", "a folder with a verb.toml"))


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar per stage on stderr; silent where stderr is no terminal."""
    columns = (TextColumn("{task.description:<18}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=err, disable=not err.is_terminal) as bars:
        tasks: dict[str, Any] = {}

        def say(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield say


def parse_at(text: str) -> dict[str, float]:
    """Adverbs from ``name=value,name=value``."""
    adverbs: dict[str, float] = {}
    for part in filter(None, text.split(",")):
        name, found, value = part.partition("=")
        try:
            adverbs[name.strip()] = float(value)
        except ValueError:
            raise OutOfRange(f"'{part}' is no adverb; write name=value, e.g. x=0.3,y=1.1") from None
        if not found:
            raise OutOfRange(f"'{part}' is no adverb; write name=value, e.g. x=0.3,y=1.1")
    return adverbs


def _print_json(value: Any) -> None:
    typer.echo(json.dumps(value, indent=2, ensure_ascii=False))


@app.command("build")
def build_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with verb.toml and its motion files.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File to write; NAME.verb by default.")] = None,
    as_json: Json = False,
) -> None:
    """Build a verb from its source folder.

    Example: [bold]adverb build mocap/reach -o reach.verb[/]
    """
    from verbs.authoring.fit import build
    from verbs.io import artifact

    with _progress() as say:
        built = build(folder, progress=say)
    path = output or Path(f"{built.verb.name}.verb")
    artifact.save(built.verb, path)
    for warning in built.warnings:
        err.print(f"[yellow]warning:[/] {_plain(warning)}", soft_wrap=True)
    if as_json:
        verb = built.verb
        _print_json({"file": str(path), "name": verb.name, "examples": len(verb.examples), **verb.quality,
                     "warnings": list(built.warnings)})  # fmt: skip
        return
    out.print(_build_table(built, path))


def _build_table(built: Built, path: Path) -> Table:
    verb, quality = built.verb, built.verb.quality
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    unit = verb.measure.unit
    table.add_row("verb", f"{verb.name} → {path} ({path.stat().st_size / 1e6:.1f} MB)")
    table.add_row("examples", f"{len(verb.examples)}, {verb.intervals + 1} canonical keys, {len(verb.skeleton)} joints")
    for adverb in verb.adverbs:
        style = ", style" if adverb.style else ""
        table.add_row(f"  {adverb.name}", f"{adverb.minimum:.3f} to {adverb.maximum:.3f} {adverb.unit}{style}")
    table.add_row("domain", quality["domain"])
    table.add_row("condition", f"{quality['condition']:.3g} (radial system)")
    table.add_row("curves", f"within {quality['curve_error_max_m'] * 1000:.2f} mm of every joint at every source frame")
    table.add_row("chart", quality["chart_reason"])
    if "methods" in quality:
        table.add_row("worst stored", _plain(built.worst_stored))
        table.add_row("at examples", f"error ≤ {quality['error_examples_max_m']:.1e} {unit}")
        for name, found in quality["methods"].items():
            table.add_row(
                f"inside, {name}",
                f"error {found['error_mean_m']:.3g} {unit} mean, {found['error_max_m']:.3g} {unit} max, "
                f"Σ|w| ≤ {found['weight_sum_max']:.2f} over {quality['samples']} random points",
            )
    return table


@app.command("info")
def info_command(verb: VerbArgument, as_json: Json = False) -> None:
    """Say what a verb is: adverbs, examples, domain, measured quality.

    Example: [bold]adverb info reach --json[/]
    """
    from verbs.blend.methods import default_method
    from verbs.runtime import describe

    loaded = open_verb(verb)
    if as_json:
        _print_json(describe.describe(loaded))
        return
    table = Table(
        title=f"{loaded.name}: {loaded.description}" if loaded.description else loaded.name,
        title_justify="left",
    )
    for column in ("adverb", "from", "to", "unit", "meaning"):
        table.add_column(column, overflow="fold", justify="right" if column in ("from", "to") else "left")
    for adverb in loaded.adverbs:
        meaning = adverb.description + (" (style)" if adverb.style else "")
        table.add_row(adverb.name, f"{adverb.minimum:.3f}", f"{adverb.maximum:.3f}", adverb.unit, meaning)
    out.print(table)
    low, high = loaded.keytimes[:, -1].min(), loaded.keytimes[:, -1].max()
    out.print(
        f"{len(loaded.examples)} examples of {low:.2f} to {high:.2f} s, {len(loaded.skeleton)} joints, "
        f"keytimes {', '.join(loaded.keytime_names)}{', looping' if loaded.looping else ''}; "
        f"default method {default_method(loaded)}"
    )


@app.command("pose")
def pose_command(
    verb: VerbArgument,
    at: At,
    phase: Annotated[float | None, typer.Option(help="Canonical time, 0 to 1.")] = None,
    time: Annotated[float | None, typer.Option(help="Seconds from the start.")] = None,
    method: MethodOption = None,
    as_json: Json = False,
) -> None:
    """Ask a verb for one pose.

    Example: [bold]adverb pose reach --at x=-0.3,y=1.2,z=0.4 --phase 0.5[/]
    """
    from verbs.runtime import describe
    from verbs.runtime.evaluate import Evaluator

    evaluator = Evaluator(open_verb(verb))
    poses = evaluator.pose(parse_at(at), phase=phase, time_s=time, method=method)
    record = describe.pose_record(evaluator, poses, 0)
    if as_json:
        _print_json(record)
        return
    table = Table("joint", "x", "y", "z", "w", title="local rotations", title_justify="left")
    for name, rotation in zip(evaluator.verb.skeleton.names, poses.rotations[0], strict=True):
        table.add_row(name, *(f"{value:+.4f}" for value in rotation))
    out.print(table)
    unit = evaluator.verb.measure.unit
    error = "none (style only)" if record["error"] is None else f"{record['error']:.4g} {unit}"
    reached = ", ".join(f"{name} {value:.4f}" for name, value in record["measured"].items())
    out.print(
        f"phase {record['phase']:.4f}, {record['time']:.3f} of {record['duration']:.3f} s, method {record['method']}"
    )
    out.print(f"reached {reached or 'nothing measurable'}; error {error}{'; clamped' if record['clamped'] else ''}")


@app.command("measure")
def measure_command(
    verb: VerbArgument,
    method: Annotated[str, typer.Option("--method", help=f"all, or one of {METHODS}.")] = "all",
    grid: Annotated[int, typer.Option(min=5, max=401, help="Nodes to a side of the smoothness slices.")] = 61,
    feet: Annotated[bool, typer.Option("--feet", help="Also measure how far feet slide while they stand.")] = False,
    as_json: Json = False,
) -> None:
    """Measure parametric error, smoothness and time of one method, or of all.

    Example: [bold]adverb measure reach --method rbf --json[/]
    """
    from verbs.blend.methods import usable
    from verbs.quality.report import measure, recommend

    loaded = open_verb(verb)
    chosen = list(usable(loaded)) if method == "all" else [method]
    with _progress() as say:
        rows: list[Figures] = []
        for k, name in enumerate(chosen):
            say("measuring", k, len(chosen))
            rows.append(measure(loaded, name, nodes=grid, slide=feet))
        say("measuring", len(chosen), len(chosen))
    if as_json:
        found: dict[str, Any] = {"verb": loaded.name, "methods": {row.method: row.as_dict() for row in rows}}
        if len(rows) > 1:
            found["recommendation"] = recommend(rows)
        _print_json(found)
        return
    out.print(_measure_table(loaded, rows))
    if feet:
        out.print(_slide_table(loaded, rows))
    if len(rows) > 1:
        out.print(recommend(rows))


def _measure_table(verb: Verb, rows: list[Figures]) -> Table:
    unit = verb.measure.unit
    heads = (
        "method",
        f"error mean, {unit}",
        "max",
        "mean, %",
        "max, %",
        "κ mean",
        "κ max",
        "zoom",
        "Σ|w| max",
        "µs",
    )
    table = Table(*heads, title=f"{verb.name}, {rows[0].domain}", caption=rows[0].grid, title_justify="left")
    for row in rows:
        table.add_row(
            row.method,
            f"{row.error_mean_m:.4g}",
            f"{row.error_max_m:.4g}",
            f"{row.error_mean_pct:.3g}",
            f"{row.error_max_pct:.3g}",
            f"{row.smoothness:.3g}",
            f"{row.smoothness_max:.3g}",
            f"{row.zoom_ratio:.2f}",
            f"{row.weight_sum_max:.2f}",
            f"{row.query_us:.2f}",
        )
    return table


def _slide_table(verb: Verb, rows: list[Figures]) -> Table:
    """Millimetres; – where the skeleton has no toes."""
    table = Table("method", "median", "p90", "max", title=f"{verb.name}, foot slide, mm", title_justify="left")
    for row in rows:
        numbers = (row.slide_median_m, row.slide_p90_m, row.slide_max_m)
        table.add_row(row.method, *("–" if isnan(value) else f"{1000 * value:.1f}" for value in numbers))
    return table


@app.command("refine")
def refine_command(
    verb: VerbArgument,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File to write; NAME.verb by default.")] = None,
    target_error: Annotated[float, typer.Option(min=0, help="Largest error to stop at, % of the diagonal.")] = 0.1,
    max_pseudo: Annotated[int, typer.Option(min=1, max=2000, help="Most pseudo-examples to insert.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the points among which the worst is sought.")] = 0,
    radii: Annotated[
        str, typer.Option(help="local keeps the radii of centers that are there; global renews all.")
    ] = "local",
    planes: Annotated[str, typer.Option(help="frozen keeps the fitted planes; refit fits them again.")] = "frozen",
    as_json: Json = False,
) -> None:
    """Insert pseudo-examples where a verb is worst, for the methods refined and hybrid.

    Example: [bold]adverb refine arm3 --max-pseudo 100 -o arm3_refined.verb[/]
    """
    from verbs import refine as refining
    from verbs.io import artifact

    loaded = open_verb(verb)
    rules = refining.Rules(target_error / 100.0, max_pseudo, seed, radii=radii, planes=planes)
    curve: list[tuple[int, float, float]] = []
    with _progress() as say:
        for step in refining.refine(loaded, rules):
            curve.append((step.pseudo, 100 * step.after.mean, 100 * step.after.largest))
            say("pseudo-examples", step.pseudo, max_pseudo)
    path = output or Path(f"{loaded.name}.verb")
    artifact.save(refining.with_basis(loaded, step.basis, rules, step.mark), path)
    if as_json:
        fields = ("pseudo", "error_mean_pct", "error_max_pct")
        rows = [dict(zip(fields, point, strict=True)) for point in curve]
        _print_json({"file": str(path), "stopped": step.mark.stopped, "curve": rows})
        return
    table = Table("pseudo-examples", "mean, %", "max, %", title=f"{loaded.name} → {path}", title_justify="left")
    for k, (pseudo, mean, largest) in enumerate(curve):
        if k in {0, len(curve) - 1} or pseudo in {1, 2, 5, 10, 20, 50, 100, 200, 500, 1000}:
            table.add_row(str(pseudo), f"{mean:.3f}", f"{largest:.3f}")
    out.print(table)
    out.print(f"stopped: {step.mark.stopped}")


@app.command("export")
def export_command(
    verb: VerbArgument,
    at: At,
    output: Annotated[Path, typer.Option("-o", "--output", help="File to write.")],
    form: Annotated[str, typer.Option("--format", help="bvh.")] = "bvh",
    fps: Annotated[float, typer.Option(min=1, max=240, help="Frames per second.")] = 30.0,
    cycles: Annotated[int, typer.Option(min=1, max=100, help="Cycles of a looping verb.")] = 1,
    method: MethodOption = None,
) -> None:
    """Write a whole motion to a file.

    Example: [bold]adverb export reach --at x=-0.3,y=1.2,z=0.4 --format bvh -o reach.bvh[/]
    """
    from verbs.io import bvh
    from verbs.runtime import sequence
    from verbs.runtime.evaluate import Evaluator

    if form != "bvh":
        raise UnknownName("format", form, ("bvh",))
    if output.is_dir():
        raise RequestError(f"{output} is a folder; name a file to write")
    evaluator = Evaluator(open_verb(verb))
    poses = sequence.sequence(evaluator, evaluator.adverbs(parse_at(at)), fps, cycles=cycles, method=method)
    bvh.write(sequence.to_motion(evaluator, poses, fps), output)
    err.print(f"{output}: {len(poses.root)} frames at {fps:g} fps, {poses.duration_s[0] * cycles:.2f} s")


@app.command("figures")
def figures_command(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for results.md and figures/.")] = Path("docs"),
    data: Annotated[
        Path | None, typer.Option(help="Folder of captured verb sources; the built-in verbs without it.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Coarse grids, built-in verbs: to see that it works.")] = False,
) -> None:
    """Make the papers' tables and figures anew, from our own runs. Takes minutes.

    Example: [bold]adverb figures --data mocap -o docs[/]
    """
    from verbs.figures import figures  # its pictures need matplotlib, which nothing else does

    with _progress() as say:
        paths = figures(output, data=data, quick=quick, progress=say)
    for path in paths:
        typer.echo(path)
