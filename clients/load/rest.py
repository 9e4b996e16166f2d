"""Runs the REST load for some seconds and prints a summary: Locust without its web page. Needs `locust`."""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

from adverb_load.process import serve

EXAMPLES = """
examples:
  python clients/load/rest.py --serve --seconds 10
  python clients/load/rest.py --url http://127.0.0.1:8000 --users 32 --verb board

exit status: 0 if every response is correct, 1 if not, 2 wrong arguments, no server or no locust
"""


def main() -> int:
    """Parse the command line and run the load; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="rest.py", description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="address of the server (%(default)s)")
    parser.add_argument("--serve", action="store_true", help="start a server on a free port for the run")
    parser.add_argument("--verb", default="reach", help="verb to request (%(default)s)")
    parser.add_argument("--users", type=int, default=8, help="concurrent clients (%(default)s)")
    parser.add_argument("--seconds", type=int, default=10, help="duration (%(default)s)")
    chosen = parser.parse_args()
    if chosen.serve:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-c", "from service.cli import main; main()", "serve", "--port", "0"]
            with serve([*command, "--data", folder], core=None, cwd=Path(folder)) as server:
                return _load(server.base, chosen)
    return _load(chosen.url, chosen)


def _load(url: str, chosen: argparse.Namespace) -> int:
    """Run Locust against a server; returns the exit status."""
    if importlib.util.find_spec("locust") is None:
        sys.stderr.write("error: the package locust is not installed; pip install locust\n")
        return 2
    command = [sys.executable, "-m", "locust", "-f", str(Path(__file__).with_name("locustfile.py"))]
    options = {
        "--host": url,
        "--verb": chosen.verb,
        "-u": chosen.users,
        "-r": chosen.users,
        "-t": f"{chosen.seconds}s",
        "--loglevel": "WARNING",
    }
    arguments = [str(word) for pair in options.items() for word in pair]
    try:
        return subprocess.run(
            [*command, "--headless", "--only-summary", *arguments], check=False, timeout=chosen.seconds + 60
        ).returncode
    except subprocess.TimeoutExpired:
        sys.stderr.write("error: the load did not end in time\n")
        return 1


if __name__ == "__main__":
    sys.exit(main())
