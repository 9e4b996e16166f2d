"""Arguments and options that several commands share, and how they are read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from verbs.cli.output import progress
from verbs.errors import OutOfRange, UnknownName

if TYPE_CHECKING:
    from verbs.verb import Verb

__all__ = ["METHODS", "At", "Json", "MethodOption", "Plant", "VerbArgument", "open_verb", "parse_at"]

VerbArgument = Annotated[str, typer.Argument(metavar="VERB", help="A built-in name, a .verb file, or a source folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
At = Annotated[str, typer.Option("--at", metavar="NAME=VALUE,…", help="Adverbs, e.g. x=-0.3,y=1.2,z=0.4.")]
METHODS = "rbf, perdof, search, refined, hybrid, barycentric, knn, inverse, corrected"
MethodOption = Annotated[str | None, typer.Option("--method", help=f"One of {METHODS}.")]

Plant = Annotated[bool, typer.Option("--plant/--no-plant", help="Hold standing feet where they landed.")]


def open_verb(name: str) -> Verb:
    """A verb by built-in name, ``.verb`` file or source folder."""
    from verbs import library
    from verbs.io import artifact

    path = Path(name)
    if name in library.names():
        return library.load(name)
    if path.is_dir():
        from verbs.authoring.fit import build

        with progress() as report:
            return build(path, progress=report).verb
    if path.exists():
        return artifact.load(path)
    raise UnknownName("verb", name, (*library.names(), "a .verb file", "a folder with a verb.toml"))


def parse_at(text: str) -> dict[str, float]:
    """Adverbs from ``name=value,name=value``."""
    adverbs: dict[str, float] = {}
    for part in filter(None, text.split(",")):
        name, found, value = part.partition("=")
        try:
            adverbs[name.strip()] = float(value)
        except ValueError:
            raise OutOfRange(f"'{part}' is not an adverb; write name=value, e.g. x=0.3,y=1.1") from None
        if not found:
            raise OutOfRange(f"'{part}' is not an adverb; write name=value, e.g. x=0.3,y=1.1")
    return adverbs
