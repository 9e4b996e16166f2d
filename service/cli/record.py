"""Command ``record``: the frames of a stream as a file for Rerun or NumPy."""

from __future__ import annotations

import importlib.util
import os
import time
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from service.cli.options import USER_ERROR
from verbs.cli.options import parse_at
from verbs.cli.output import err, plain

__all__ = ["KEY", "record_command"]

KEY = "ADVERB_KEY"
"""Environment variable with the key of the server."""

ENDINGS = (".rrd", ".npz")


def record_command(
    verb: Annotated[str, typer.Argument(metavar="VERB", help="A verb of the server.")],
    output: Annotated[list[Path], typer.Option("-o", "--output", metavar="FILE", help="A file, .rrd or .npz.")],
    at: Annotated[str, typer.Option("--at", metavar="NAME=VALUE,…", help="Adverbs. Default: the middle.")] = "",
    url: Annotated[str, typer.Option(help="Address of the server.")] = "http://127.0.0.1:8000",
    seconds: Annotated[float, typer.Option(min=0.1, max=3600, help="Length of the recording.")] = 5.0,
    fps: Annotated[int, typer.Option(min=1, max=120, help="Frames per second.")] = 60,
    wander: Annotated[
        float | None, typer.Option(min=0.1, max=3600, metavar="SECONDS", help="Go to another example so often.")
    ] = None,
    hold: Annotated[bool, typer.Option("--hold", help="Stay at the keytime, where the effector follows.")] = False,
    channel: Annotated[int, typer.Option(min=0, max=65_535, help="Number of the channel.")] = 0,
    method: Annotated[str | None, typer.Option(help="Blending method of the server.")] = None,
    seed: Annotated[int, typer.Option(help="Of --wander.")] = 1,
) -> None:
    """Record a channel of a server's stream for some seconds: for Rerun (.rrd), or as arrays (.npz).

    Needs adverb-client, and for .rrd its extra "rerun". The key of the server is read from ADVERB_KEY.

    Example: [bold]adverb record reach --at x=-0.3,y=1.2,z=0.4 --wander 1 -o reach.rrd -o reach.npz[/]
    """
    _check(output)
    options: dict[str, Any] = {"fps": fps, "loop": True}
    options |= {"method": method} if method else {}
    options |= {"adverbs": parse_at(at)} if at else {}
    from adverb_client import AdverbError

    try:
        found = _recorded(verb, url, options, seconds, wander, channel, seed, hold=hold)
    except (AdverbError, ValueError, KeyError) as problem:
        _fail(str(problem))
    for file in output:
        found.save(file)
        err.print(f"{plain(str(file))}: {len(found)} frames in {found.times_s[-1]:.2f} s")


def _check(output: list[Path]) -> None:
    """Refuse files that cannot be written, before anything is recorded."""
    if importlib.util.find_spec("adverb_client") is None:
        _fail("recording needs adverb-client, which is not installed; pip install ./clients/python")
    for file in output:
        if file.suffix not in ENDINGS:
            _fail(f"{file}: expected an ending of {', '.join(ENDINGS)}")
        if not file.absolute().parent.is_dir():
            _fail(f"{file}: the folder does not exist")
        if file.suffix == ".rrd" and importlib.util.find_spec("rerun") is None:
            _fail("a file for Rerun needs rerun-sdk; pip install rerun-sdk, or write .npz")


def _recorded(
    verb: str, url: str, options: dict[str, Any], seconds: float, wander: float | None, channel: int, seed: int,
    *, hold: bool,
) -> Any:  # fmt: skip
    """Open a channel and record it."""
    import numpy as np
    from adverb_client import Client, Recorder, SyncStream

    key = os.environ.get(KEY)
    with Client(url, api_key=key) as client:
        info = client.verb(verb)
    if hold:
        if info.measure.get("keytime") not in info.keytimes:
            raise ValueError(f"--hold needs a verb that is measured by a position; '{verb}' is not")
        options |= {"play": False, "phase": info.keytimes[info.measure["keytime"]]}
    rng, names = np.random.default_rng(seed), [adverb.name for adverb in info.adverbs]
    with SyncStream(url, api_key=key) as stream:
        opened = stream.open(verb, number=channel, **options)
        with Recorder(opened, info.measure.get("effector") or "") as recorder:
            began_s, next_s = time.monotonic(), 0.0
            while (now_s := time.monotonic() - began_s) < seconds:
                if wander is not None and now_s >= next_s:
                    example = info.examples[int(rng.integers(len(info.examples)))]
                    opened.aim([example.adverbs[name] for name in names])
                    next_s += wander
                time.sleep(min(0.02, seconds - now_s))
        return recorder.recording()


def _fail(problem: str) -> NoReturn:
    typer.echo(f"error: {problem}", err=True)
    raise typer.Exit(USER_ERROR)
