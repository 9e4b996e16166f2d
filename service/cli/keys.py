"""Commands of API keys: ``adverb keys create``, ``list`` and ``revoke``."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from service.cli.options import DEFAULT_DATA, USER_ERROR, settings_of
from service.run.listener import folder_problem

if TYPE_CHECKING:
    from service.store.keys import Keys
    from service.store.records import Key

__all__ = ["app", "seconds_until"]

_UNITS_S = {"s": 1, "m": 60, "h": 3_600, "d": 86_400, "w": 604_800}

app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich", help="Make, list and revoke API keys of a server.")

Data = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the server. [default: data]")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@app.command("create")
def create_command(
    scope: Annotated[
        list[str],
        typer.Option(
            help="What the key may do; repeat it for several. pose: request poses and streams; author: upload, change "
            "and delete verbs; refine: start and cancel refinements; admin: all, and the list of changes."
        ),
    ],
    name: Annotated[str, typer.Option(help="Name by which you recognise the key.")] = "",
    expires: Annotated[
        str | None, typer.Option(help="End: 12h, 30d, 8w, or a date 2027-01-31 (UTC). [default: never]")
    ] = None,
    data: Data = None,
    as_json: AsJson = False,
) -> None:
    """Make a key. It is shown once and cannot be read again; the server stores its hash.

    The first key of a server ends its use without keys. It takes effect on running servers within a second.

    Example: [bold]adverb keys create --scope pose --name game --expires 90d[/]
    """
    from service.access.keys import SCOPES, hash_of, new

    scopes = frozenset(part.strip() for text in scope for part in text.split(","))
    if not scopes or not scopes <= set(SCOPES):
        _fail(f"unknown scope '{', '.join(sorted(scopes - set(SCOPES)))}'; known: {', '.join(SCOPES)}")
    if len(name) > 100 or not name.isprintable():
        _fail("a name has at most 100 printable characters")
    expires_at_s = None if expires is None else _end_of(expires)
    id, text = new()
    with _opened(data, make=True) as keys:
        key = keys.add(id, hash_of(text), name=name, scopes=scopes, expires_at_s=expires_at_s)
    if as_json:
        typer.echo(json.dumps({"id": id, "key": text}))
        return
    typer.echo(text)
    end = "never expires" if key.expires_at_s is None else f"expires {_date(key.expires_at_s)}"
    typer.echo(
        f"Key {id} has the scopes {', '.join(sorted(scopes))} and {end}. Store it now: it is not shown again.", err=True
    )


@app.command("list")
def list_command(data: Data = None, as_json: AsJson = False) -> None:
    """List the keys, the oldest first, without their secrets.

    Example: [bold]adverb keys list --data verbs[/]
    """
    with _opened(data) as keys:
        rows = keys.listed()
    if as_json:
        typer.echo(json.dumps([_row(key) for key in rows], indent=2))
        return
    if not rows:
        typer.echo("There are no keys; adverb keys create makes one.", err=True)
        return
    from rich.table import Table

    from verbs.cli.output import out, plain

    table = Table()
    for column in ("id", "name", "scopes", "made", "expires", "state"):
        table.add_column(column)
    for key in rows:
        end = "never" if key.expires_at_s is None else _date(key.expires_at_s)
        made, scopes = _date(key.created_at_s), ", ".join(sorted(key.scopes))
        table.add_row(key.id, plain(key.name), scopes, made, end, _state(key))
    out.print(table)


@app.command("revoke")
def revoke_command(
    ids: Annotated[list[str], typer.Argument(metavar="ID…", help="Ids of keys, as adverb keys list shows them.")],
    data: Data = None,
) -> None:
    """Revoke keys for good. Servers refuse them, and end their streams, within a second.

    Example: [bold]adverb keys revoke 9f3c2a7b5d1e4f60[/]
    """
    with _opened(data) as keys:
        for id in ids:
            typer.echo(f"Key {keys.revoke(id).id} is revoked.", err=True)


def seconds_until(text: str, now_s: float) -> float:
    """Seconds from now until an end as ``--expires`` takes it; raises ValueError."""
    found = re.fullmatch(r"(\d{1,6})([smhdw])", text.strip())
    if found:
        return float(int(found[1]) * _UNITS_S[found[2]])
    end = datetime.fromisoformat(text.strip())
    return (end if end.tzinfo else end.replace(tzinfo=UTC)).timestamp() - now_s


def _end_of(text: str) -> float:
    """End of a key, seconds since 1970; exits where it cannot be read or is past."""
    now_s = time.time()
    try:
        left_s = seconds_until(text, now_s)
    except ValueError:
        _fail(f"--expires is '{text[:40]}'; write 12h, 30d, 8w, or a date 2027-01-31")
    if not 0.0 < left_s < 100 * 365 * 86_400:
        _fail(f"--expires is '{text[:40]}', which is past, or more than a hundred years away")
    return now_s + left_s


@contextmanager
def _opened(data: Path | None, *, make: bool = False) -> Iterator[Keys]:
    """The keys of the settings' database; exits with a message for errors of the store."""
    from service.store.keys import open_keys
    from service.store.records import StoreError

    settings = settings_of(data=data)
    if settings.data is None:
        settings = settings.model_copy(update={"data": DEFAULT_DATA})
        if make and settings.database_url is None:
            DEFAULT_DATA.mkdir(exist_ok=True)
    folder = settings.data
    if settings.database_url is None and folder is not None and (problem := folder_problem(folder)):
        _fail(f"{problem}; name the folder of the server (--data)")
    try:
        keys = open_keys(settings.database)
        try:
            yield keys
        finally:
            keys.close()
    except StoreError as err:
        _fail(str(err))


def _row(key: Key) -> dict[str, Any]:
    return {
        "id": key.id,
        "name": key.name,
        "scopes": sorted(key.scopes),
        "created_at": key.created_at_s,
        "expires_at": key.expires_at_s,
        "revoked_at": key.revoked_at_s,
        "state": _state(key),
    }


def _state(key: Key) -> str:
    if key.revoked_at_s is not None:
        return "revoked"
    return "valid" if key.valid_at(time.time()) else "expired"


def _date(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).strftime("%Y-%m-%d %H:%M")


def _fail(problem: str) -> NoReturn:
    typer.echo(f"error: {problem}", err=True)
    raise typer.Exit(USER_ERROR)
