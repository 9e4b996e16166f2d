"""Commands ``mirror``, ``trim`` and ``resample``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from verbs.cli.options import Json
from verbs.cli.output import err, out, plain, print_json
from verbs.errors import MotionFileError, SourceError

if TYPE_CHECKING:
    from verbs.clips.mirror import Mirrored
    from verbs.motion import Motion

__all__ = ["mirror_command", "resample_command", "trim_command"]

File = Annotated[Path, typer.Argument(metavar="FILE", help="A motion file: .bvh, .glb, .gltf, .npz.")]
Output = Annotated[
    Path, typer.Option("-o", "--output", help="File to write: .bvh in the unit of the input, .glb, .npz, ….")
]
Unit = Annotated[str, typer.Option("--unit", help="Unit of length of a file: m, cm, mm, …")]


def mirror_command(
    path: Annotated[
        Path, typer.Argument(metavar="FILE|DIR", help="A motion file, a verb source, or a folder of clips.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="File, or new folder, to write.")],
    pairs: Annotated[Path | None, typer.Option("--pairs", help='TOML file of odd pairs: "Arm_1" = "Arm_2".')] = None,
    unit: Unit = "m",
    as_json: Json = False,
) -> None:
    """Mirror a clip, or a whole verb source, left to right.

    Example: [bold]adverb mirror mocap/reach -o reach_left[/]
    """
    from verbs.authoring.mirrored_source import mirror_source
    from verbs.clips.mirror import mirror
    from verbs.io.motion_files import ENDINGS

    table = _pairs(pairs)
    if (path / "verb.toml").exists():
        done = mirror_source(path, output, table)
    elif path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in ENDINGS)
        if not files:
            raise SourceError(path, "has neither a verb.toml nor motion files")
        if len({file.stem for file in files}) < len(files):
            raise SourceError(path, "has motion files that differ in their ending alone; rename one")
        if output.exists() and (not output.is_dir() or any(output.iterdir())):
            raise SourceError(output, "is not empty; name a new folder")
        done = [mirror(_read(file, unit), table) for file in files]
        output.mkdir(parents=True, exist_ok=True)
        for file, mirrored in zip(files, done, strict=True):
            _write(mirrored.motion, output / f"{file.stem}.bvh", unit)
    else:
        done = [mirror(_read(path, unit), table)]
        _write(done[0].motion, output, unit)
    _report_mirrored(done, output, as_json)


def trim_command(
    file: File,
    start: Annotated[float, typer.Option("--from", help="First second that is kept.")],
    end: Annotated[float, typer.Option("--to", help="Last second that is kept.")],
    output: Output,
    unit: Unit = "m",
    as_json: Json = False,
) -> None:
    """Cut a clip to a stretch of time, to any fraction of a frame.

    Example: [bold]adverb trim walk.bvh --from 1.25 --to 2.4 -o cycle.bvh[/]
    """
    from verbs.clips.resample import trim

    _save(trim(_read(file, unit), start, end), output, unit, as_json)


def resample_command(
    file: File,
    fps: Annotated[float, typer.Option("--fps", help="Frames per second of the result.")],
    output: Output,
    unit: Unit = "m",
    as_json: Json = False,
) -> None:
    """Resample a clip at another frame rate, by cubic splines.

    Example: [bold]adverb resample walk.bvh --fps 60 -o walk60.bvh[/]
    """
    from verbs.clips.resample import resample

    _save(resample(_read(file, unit), fps), output, unit, as_json)


def _read(file: Path, unit: str) -> Motion:
    from verbs.io import motion_files

    return motion_files.read(file, unit=unit).motion


def _write(motion: Motion, file: Path, unit: str) -> None:
    from verbs.io import motion_files

    motion_files.write(motion, file, unit=unit)


def _save(motion: Motion, output: Path, unit: str, as_json: bool) -> None:
    _write(motion, output, unit)
    if as_json:
        print_json({"file": str(output), "frames": len(motion), "fps": motion.fps, "seconds": motion.duration_s})
        return
    out.print(f"{plain(str(output))}: {len(motion)} frames, {motion.duration_s:.3f} s at {motion.fps:g} fps")


def _pairs(file: Path | None) -> dict[str, str] | None:
    """Pairs of joints from a TOML file: names to names, at the top or in a table ``[pairs]``."""
    import tomllib

    if file is None:
        return None
    try:
        table: dict[str, Any] = tomllib.loads(file.read_text("utf-8-sig"))
    except OSError as problem:
        raise MotionFileError(file, None, "a file that can be read", problem.strerror or str(problem)) from problem
    except ValueError as problem:
        raise MotionFileError(file, None, "a table of pairs in TOML", str(problem)) from problem
    rows = table.get("pairs", table)
    if not isinstance(rows, dict) or not all(isinstance(name, str) for name in rows.values()):
        raise MotionFileError(file, None, 'pairs of joint names, as "Arm_1" = "Arm_2"', "other values")
    return rows


def _report_mirrored(done: Sequence[Mirrored], output: Path, as_json: bool) -> None:
    unmatched = sorted({name for one in done for name in one.unmatched})
    bones: dict[str, float] = {}
    for name, length in (pair for one in done for pair in one.bones):
        bones[name] = max(bones.get(name, 0.0), 1000.0 * length)
    if as_json:
        rounded = {name: round(length, 3) for name, length in bones.items()}
        print_json({"output": str(output), "clips": len(done), "unmatched": unmatched, "bones_mm": rounded})
        return
    out.print(f"{plain(str(output))}: {len(done)} clip{'s' * (len(done) != 1)} mirrored")
    if unmatched:
        err.print(f"[yellow]warning:[/] no partner for {plain(', '.join(unmatched))}; name pairs with --pairs")
    for name, length in bones.items():
        err.print(f"[yellow]warning:[/] the bone to {plain(name)} differs from its partner's by {length:.1f} mm")
