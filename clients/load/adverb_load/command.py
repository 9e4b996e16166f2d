"""Command line of the load tester: ``adverb load``, or ``python -m adverb_load`` without the server's package."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from adverb_load.compare import compare, lines_of_comparison, read_report
from adverb_load.compare_html import comparison_page
from adverb_load.engine import run
from adverb_load.goals import RequestError
from adverb_load.profile import Profile, ProfileError, built_in, read
from adverb_load.report_html import page
from adverb_load.report_text import faults_of, lines_of
from adverb_load.target import Target, is_loopback

__all__ = ["main"]

KEY = "ADVERB_KEY"
DESCRIPTION = """Load a server with streams and requests, open loop, and report what it delivers.

Requests and goals are due at times that do not depend on the server (constant or Poisson arrivals), and their latency
counts from the time at which they were due. So a server that stalls is charged for every request that it delays.
Errors of poses are measured again here, by forward kinematics."""
EXAMPLES = f"""
examples:
  adverb load --profile arena
  adverb load --profile crowd --scale 0.5 --duration 60 --json crowd.json --html crowd.html
  adverb load --profile mine.toml --rate 200 --seed 7
  adverb load compare before.json after.json --fail-over 10
  adverb load --list

The key of the server, if it needs one, is read from the environment variable {KEY}.
exit status: 0 done; 1 a user error, no server, malformed responses, poses that are not where the server states, or
(compare) something is worse by more than --fail-over; 2 wrong usage
"""


def main(arguments: Sequence[str] | None = None, prog: str = "adverb load") -> int:
    """Parse the command line and run; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["compare"]:
        return _compare(_compare_arguments(given[1:], prog))
    chosen = _arguments(given, prog)
    if chosen.list:
        sys.stdout.write("\n".join(f"{name:<12}{read(name).description}" for name in built_in()) + "\n")
        return 0
    try:
        return _load(chosen)
    except (ProfileError, RequestError, OSError, TimeoutError) as err:
        sys.stderr.write(f"error: {err or type(err).__name__}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("error: interrupted before the measurement\n")
        return 1


def _arguments(given: Sequence[str], prog: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog=prog, description=DESCRIPTION, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--profile", default="arena", help=f"{', '.join(built_in())}, or a .toml file (%(default)s)")
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="address of the server (%(default)s)")
    parser.add_argument("--allow-remote", action="store_true", help="allow a server that is not on this machine")
    parser.add_argument("--duration", type=_positive, metavar="S", help="seconds that are measured (the profile's)")
    parser.add_argument("--warmup", type=_seconds, metavar="S", help="seconds before that (the profile's)")
    parser.add_argument("--scale", type=_positive, metavar="X", help="multiply sockets and rates by X (1)")
    parser.add_argument("--rate", type=_positive, metavar="HZ", help="requests per second in all (the profile's)")
    parser.add_argument("--seed", type=int, default=1, help="of arrivals and goals (%(default)s)")
    parser.add_argument("--json", metavar="FILE", help="write the report as JSON; - is stdout")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write the report as one page with plots")
    parser.add_argument("--list", action="store_true", help="list the built-in profiles")
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr")
    return parser.parse_args(given)


def _compare_arguments(given: Sequence[str], prog: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"{prog} compare", description=compare.__doc__.split("\n\n")[0])  # type: ignore[union-attr]
    parser.add_argument("before", type=Path, metavar="A.json", help="report of the first run")
    parser.add_argument("after", type=Path, metavar="B.json", help="report of the second run")
    parser.add_argument(
        "--fail-over", type=_seconds, metavar="PERCENT", help="exit with 1 if a figure is worse by more, beyond noise"
    )
    parser.add_argument("--html", type=Path, metavar="FILE", help="write the comparison as one page")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser.parse_args(given)


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text}; expected a positive number")
    return value


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < 1e6:
        raise argparse.ArgumentTypeError(f"{text}; expected a number, 0 or more")
    return value


def _load(chosen: argparse.Namespace) -> int:
    if not is_loopback(chosen.url) and not chosen.allow_remote:
        raise RequestError(f"{chosen.url} is not on this machine; --allow-remote loads it, if it is yours")
    profile = _profile(chosen)
    target = Target(chosen.url, os.environ.get(KEY, ""), chosen.seed)
    shows = not chosen.quiet and sys.stderr.isatty()

    def progress(text: str) -> None:
        if shows:
            sys.stderr.write(f"\r\033[K{profile.name}: {text}")
            sys.stderr.flush()

    report = run(profile, target, seed=chosen.seed, progress=progress)
    if shows:
        sys.stderr.write("\r\033[K")
    _write(report, chosen)
    return 1 if faults_of(report) else 0


def _profile(chosen: argparse.Namespace) -> Profile:
    profile = read(chosen.profile)
    if chosen.scale is not None:
        profile = profile.scaled(chosen.scale)
    if chosen.rate is not None:
        profile = profile.at_rate(chosen.rate)
    given = {"duration_s": chosen.duration, "warmup_s": chosen.warmup}
    profile = replace(profile, **{name: value for name, value in given.items() if value is not None})
    return profile.checked()


def _write(report: dict[str, Any], chosen: argparse.Namespace) -> None:
    if chosen.json == "-":
        sys.stdout.write(json.dumps(report) + "\n")
    else:
        sys.stdout.write("\n".join(lines_of(report)) + "\n")
        if chosen.json is not None:
            Path(chosen.json).write_text(json.dumps(report) + "\n", "utf-8")
    if chosen.html is not None:
        chosen.html.write_text(page(report), "utf-8")


def _compare(chosen: argparse.Namespace) -> int:
    try:
        found = compare(read_report(chosen.before), read_report(chosen.after), fail_over=chosen.fail_over)
    except (OSError, ValueError) as err:
        sys.stderr.write(f"error: {err}\n")
        return 1
    sys.stdout.write(
        json.dumps(found.to_json()) + "\n" if chosen.json else "\n".join(lines_of_comparison(found)) + "\n"
    )
    if chosen.html is not None:
        chosen.html.write_text(comparison_page(found), "utf-8")
    return 1 if found.failed else 0
