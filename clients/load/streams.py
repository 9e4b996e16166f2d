"""Open-loop load on a server's streams, and chaos.

Many WebSockets with many channels each; prints the lateness of frames and the missing ones. Needs adverb-client and
uvloop. Run it on another core than the server: a late client makes the server look late.
"""

from __future__ import annotations

import argparse
import json
import os
import sys

from adverb_load import chaos
from adverb_load.client import Load
from adverb_load.fleet import Report, run
from adverb_load.frames import FrameError
from adverb_load.goals import RequestError

EXAMPLES = """
examples:
  python clients/load/streams.py --sockets 600 --seconds 10
  python clients/load/streams.py --sockets 50 --channels 60 --steer 10 --encoding q48
  python clients/load/streams.py --sockets 100 --channels 100 --steer 60 --bulk --no-events --encoding q32
  taskset -c 1 python clients/load/streams.py --sockets 100 --json
  python clients/load/streams.py --chaos --sockets 30 --seconds 20 --seed 7

exit status: 0 sound; 1 messages are missing unreported or malformed, or (chaos) the server has faults; 2 wrong
arguments, or no server
"""


def main() -> int:
    """Parse the command line and run the load; returns the exit status."""
    chosen = _arguments()
    load = Load(
        url=chosen.url,
        verb=chosen.verb,
        encoding=chosen.encoding,
        sockets=chosen.sockets,
        channels=chosen.channels,
        fps=chosen.fps,
        method=chosen.method,
        steer_hz=chosen.steer,
        bulk=chosen.bulk,
        events=not chosen.no_events,
        seed=chosen.seed,
    )
    if chosen.core is not None:
        os.sched_setaffinity(0, {chosen.core})
    try:
        if chosen.chaos:
            found = chaos.run(load, seconds=chosen.seconds)
            return _print(found.to_json(), chaos.lines_of(found), as_json=chosen.json, sound=found.sound)
        report = run(load, seconds=chosen.seconds)
    except (RequestError, FrameError, OSError, ValueError, TimeoutError) as err:
        sys.stderr.write(f"error: {err or type(err).__name__}\n")
        return 2
    sound = report.gaps == 0 and report.decode_errors == 0
    return _print(report.to_json(), _lines(report), as_json=chosen.json, sound=sound)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="streams.py", description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--url", default="ws://127.0.0.1:8000/v1/stream", help="address of the stream (%(default)s)")
    parser.add_argument("--sockets", type=_count, default=10, help="WebSockets (%(default)s)")
    parser.add_argument("--channels", type=_count, default=1, help="channels of each (%(default)s)")
    parser.add_argument("--fps", type=_count, default=60, help="frames per second of each channel (%(default)s)")
    parser.add_argument("--verb", default="reach", help="verb of all channels (%(default)s)")
    parser.add_argument("--method", help="blending method (the verb's own)")
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of the measurement (%(default)s)")
    parser.add_argument("--encoding", choices=["f32", "q48", "q32", "weights"], default="f32", help="(%(default)s)")
    parser.add_argument("--steer", type=float, default=0.0, metavar="HZ", help="new adverbs a second and channel (0)")
    parser.add_argument("--bulk", action="store_true", help="one message steers all channels of a socket")
    parser.add_argument("--no-events", action="store_true", help="request no keytimes")
    parser.add_argument("--seed", type=int, default=1, help="of everything random (%(default)s)")
    parser.add_argument("--core", type=int, help="CPU core to run on (any)")
    parser.add_argument("--chaos", action="store_true", help="send malformed and hostile traffic instead")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser.parse_args()


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value}; expected at least 1")
    return value


def _print(found: dict[str, object], lines: list[str], *, as_json: bool, sound: bool) -> int:
    sys.stdout.write(json.dumps(found) + "\n" if as_json else "\n".join(lines) + "\n")
    return 0 if sound else 1


def _lines(report: Report) -> list[str]:
    load, late = report.load, report.lateness_ms
    share = 100.0 * report.delivered / max(report.expected, 1)
    skipped = report.expected - report.delivered - report.dropped
    lines = [
        f"load       {load.sockets} sockets × {load.channels} channels × {load.fps} fps, {load.encoding}, "
        f"steered at {load.steer_hz:g} Hz, {report.seconds:g} s",
        f"frames     {report.delivered} of {report.expected} ({share:.2f} %); {report.dropped} dropped, "
        f"{skipped} skipped or at the window's ends, {report.gaps} missing unreported",
        f"lateness   p50 {late.p50:.2f}  p95 {late.p95:.2f}  p99 {late.p99:.2f}  max {late.max:.2f} ms "
        f"(± {0.5 * report.round_trip_ms:.2f})",
        f"bytes      {report.payload_bytes}; {report.bytes_per_pose:.1f} per pose",
        f"decoding   {report.decoded} messages decoded in full, {report.decode_errors} errors",
        f"steering   {report.steered} sent, {report.held_back} held back",
        f"client     {100.0 * report.client_cpu:.0f} % of a core",
    ]
    if report.codes or report.closes:
        lines.append(f"server     errors {report.codes}, closed {report.closes}")
    return lines + [f"problem    {problem}" for problem in report.problems]


if __name__ == "__main__":
    sys.exit(main())
