"""``make chaos``: whether the service recovers and loses nothing while its processes and its database fail.

``adverb serve`` with two servers and two workers runs on a PostgreSQL of its own and a folder of artifacts. Clients
stream, request poses, upload, activate, refine and delete, while servers and workers are killed and the database is
stopped, started and frozen. After a time without faults everything is checked, and the exit code is 1 where anything
is wrong; see docs/chaos.md.

The schedule of faults, of authors and of streams is drawn from the seed before the start: the same seed gives the same
schedule, which is printed. The interleaving of processes, and so the outcome of each operation, is not repeatable.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "clients" / "load"))

from benchmarks.chaos import report
from benchmarks.chaos.cluster import CannotRun, cluster
from benchmarks.chaos.plan import Plan
from benchmarks.chaos.run import run
from benchmarks.timing import machine


def main() -> int:
    """Run; 0 if everything holds, 1 if not, 2 if it cannot be run."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.chaos", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="how long, without the recovery (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the schedule (%(default)s)")
    parser.add_argument("--streams", type=int, default=200, help="number of streams (%(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything that was recorded")
    parser.add_argument("--log", type=Path, metavar="FILE", help="keep the log of the service")
    parser.add_argument("--write", type=Path, metavar="FILE", help="replace the tables in this document")
    chosen = parser.parse_args()
    plan = Plan.of(chosen.seed, 60.0 * chosen.minutes, chosen.streams)
    print(machine(), "\n".join(plan.lines()), sep="\n", flush=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends all processes, as Ctrl-C does
    try:
        with cluster() as running:
            try:
                ledger, checks = run(plan, running)
            finally:
                if chosen.log is not None:
                    shutil.copyfile(running.log, chosen.log)
    except CannotRun as err:
        print(f"error: {err}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; all processes have ended", file=sys.stderr)
        return 130
    print("\n".join(report.lines(checks)))
    if chosen.json is not None:
        report.save(chosen.json, plan, ledger, checks)
    if chosen.write is not None:
        command = (
            f"python -m benchmarks.chaos --minutes {chosen.minutes:g} --seed {chosen.seed} --streams {chosen.streams}"
        )
        report.write(chosen.write, report.markdown(plan, ledger, checks, command))
    return int(any(check.wrong for check in checks))


if __name__ == "__main__":
    sys.exit(main())
