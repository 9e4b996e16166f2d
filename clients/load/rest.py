"""Runs the REST load for some seconds and prints a summary: Locust without its web page. Needs the package `locust`."""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
from pathlib import Path

EXAMPLES = """
examples:
  python clients/load/rest.py --seconds 10
  python clients/load/rest.py --url http://127.0.0.1:8000 --users 32 --verb board

exit status: 0 if every request was answered well, 1 if not, 2 wrong arguments, no server or no locust
"""


def main() -> int:
    """Run what the command line asks for; the exit status."""
    parser = argparse.ArgumentParser(
        prog="rest.py", description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="address of the server (%(default)s)")
    parser.add_argument("--verb", default="reach", help="verb to ask for (%(default)s)")
    parser.add_argument("--users", type=int, default=8, help="clients at a time (%(default)s)")
    parser.add_argument("--seconds", type=int, default=10, help="how long (%(default)s)")
    chosen = parser.parse_args()
    if importlib.util.find_spec("locust") is None:
        sys.stderr.write("error: the package locust is not installed; pip install locust\n")
        return 2
    command = [sys.executable, "-m", "locust", "-f", str(Path(__file__).with_name("locustfile.py"))]
    options = {
        "--host": chosen.url,
        "--verb": chosen.verb,
        "-u": chosen.users,
        "-r": chosen.users,
        "-t": f"{chosen.seconds}s",
        "--loglevel": "WARNING",
    }
    said = [str(word) for pair in options.items() for word in pair]
    try:
        return subprocess.run(
            [*command, "--headless", "--only-summary", *said], check=False, timeout=chosen.seconds + 60
        ).returncode
    except subprocess.TimeoutExpired:
        sys.stderr.write("error: the load did not end in time\n")
        return 1


if __name__ == "__main__":
    sys.exit(main())
