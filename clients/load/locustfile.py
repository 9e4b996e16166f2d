"""Load on a server's REST routes, with Locust; errors of poses are measured independently.

    locust -f clients/load/locustfile.py --headless --host http://127.0.0.1:8000 -u 8 -r 8 -t 10s --only-summary

or ``python clients/load/rest.py``. Of the requests for one pose and for many, those at the effector's keytime are
measured: forward kinematics of the response, and the distance to the requested position.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import numpy.typing as npt
from adverb_client import DecodeError
from adverb_client.records import CLAMPED, parse_records
from adverb_load.effector import Effector
from adverb_load.goals import Goals, RequestError, fetch
from locust import FastHttpUser, between, events, task

CROWD, ROWS = 20, 200
"""Poses of a JSON and of a binary batch."""

AGREE = 1e-4
"""Largest difference to the server's measurement, metres: poses are 32-bit floats."""

BINARY = {"Accept": "application/octet-stream"}
JSON = {"Accept": "application/json"}

Numbers = npt.NDArray[np.float64]


@dataclass(slots=True)
class Found:
    """The verb and the measurements of its poses.

    Parameters
    ----------
    goals : Goals or None
    effector : Effector or None
        None if the verb is not measured by an effector's position.
    joints : int
        Of the verb's skeleton.
    errors, apart : list of float
        Measured errors; differences to those of the server.
    clamped, disagreed : int
        Poses outside the domain, not measured; poses whose error differs too much.
    """

    goals: Goals | None = None
    effector: Effector | None = None
    joints: int = 0
    errors: list[float] = field(default_factory=list)
    apart: list[float] = field(default_factory=list)
    clamped: int = 0
    disagreed: int = 0
    started_s: float = 0.0

    def measure(
        self, requested: Numbers, root: Numbers, rotations: Numbers, reported: Numbers, clamped: Any
    ) -> str | None:
        """Measure poses (B,) at the effector's keytime; returns a problem or None."""
        if self.effector is None:
            return None
        inside = ~np.asarray(clamped, bool)
        self.clamped += int(np.count_nonzero(~inside))
        errors = self.effector.errors(requested, root, rotations)[inside]
        apart = np.abs(errors - reported[inside])
        self.errors += errors.tolist()
        self.apart += apart.tolist()
        wrong = int(np.count_nonzero(apart > AGREE))
        self.disagreed += wrong
        return f"{wrong} poses are {apart.max():.4g} m from the server's error" if wrong else None


FOUND = Found()
RNG = random.Random(1)


def _options(parser: Any) -> None:
    """Add the options of this load."""
    parser.add_argument("--verb", default="reach", env_var="ADVERB_LOAD_VERB", help="verb to request")


def _prepare(environment: Any, **_: Any) -> None:
    """Fetch the description of the verb."""
    options = environment.parsed_options
    path = f"/v1/verbs/{quote(options.verb, safe='')}"
    try:
        verb = fetch(environment.host.rstrip("/"), path)
    except RequestError as err:
        sys.stderr.write(f"error: {err}\n")
        environment.process_exit_code = 2
        environment.runner.quit()
        return
    FOUND.joints = len(verb["skeleton"]["names"])
    FOUND.goals = Goals.of(verb, np.random.default_rng(1))
    FOUND.effector = Effector.of(verb)
    FOUND.started_s = time.monotonic()


def _summarise(environment: Any, **_: Any) -> None:
    """Print the summary."""
    total, seconds = environment.stats.total, max(time.monotonic() - FOUND.started_s, 1e-9)
    if not total.num_requests:
        return
    quantiles = [total.get_response_time_percentile(q) for q in (0.5, 0.95, 0.99)]
    lines = [
        f"requests   {total.num_requests}, {total.num_requests / seconds:.0f} per second",
        f"took       p50 {quantiles[0]:.0f}  p95 {quantiles[1]:.0f}  p99 {quantiles[2]:.0f} ms",
        f"failed     {total.num_failures} ({100 * total.fail_ratio:.2f} %)",
    ]
    if FOUND.errors:
        lines += [
            f"error      mean {np.mean(FOUND.errors):.3g}  max {np.max(FOUND.errors):.3g} m, measured over "
            f"{len(FOUND.errors)} poses; {FOUND.clamped} outside the domain are not measured",
            f"agreement  within {np.max(FOUND.apart):.3g} m of the server's errors; {FOUND.disagreed} poses beyond "
            f"{AGREE:g} m",
        ]
    else:
        lines.append("error      not measured: the verb's adverbs are not an effector's x, y, z")
    sys.stdout.write("\n".join(lines) + "\n")


class Animator(FastHttpUser):
    """A client that requests poses, batches and motions, as JSON and as binary records."""

    wait_time = between(0.0, 0.01)

    def on_start(self) -> None:
        """Set the path of the verb."""
        options = self.environment.parsed_options
        self.path = f"/v1/verbs/{quote(options.verb if options else 'reach', safe='')}"

    @task(10)
    def pose(self) -> None:
        """One pose, JSON."""
        row, phase, measured = self._one()
        body = {"adverbs": _named(row), "phase": phase}

        def check(response: Any) -> str | None:
            return _checked_json(row[None], [response.json()]) if measured else None

        self._post("pose", JSON, check, json=body)

    @task(10)
    def pose_binary(self) -> None:
        """One pose, a record."""
        row, phase, measured = self._one()
        body = {"adverbs": _named(row), "phase": phase}

        def check(response: Any) -> str | None:
            return _checked_records(row[None], response.content, measured=measured)

        self._post("pose", BINARY, check, json=body)

    @task(4)
    def poses(self) -> None:
        """A small batch, JSON."""
        rows, phase = _rows(CROWD), _keytime()
        body = {"items": [{"adverbs": _named(row), "phase": phase} for row in rows]}
        self._post("poses", JSON, lambda response: _checked_json(rows, response.json()["poses"]), json=body)

    @task(4)
    def poses_binary(self) -> None:
        """A large batch, binary rows in and records out."""
        rows = _rows(ROWS)
        body = np.concatenate([rows, np.full((ROWS, 1), _keytime())], axis=1).astype("<f4").tobytes()
        headers = BINARY | {"Content-Type": "application/octet-stream"}
        self._post(
            "poses", headers, lambda response: _checked_records(rows, response.content, measured=True), data=body
        )

    @task(1)
    def sequence(self) -> None:
        """A motion, JSON."""
        body = {"adverbs": _named(_rows(1)[0])}
        self._post("sequence", JSON, lambda response: None if response.json()["frames"] else "no frames", json=body)

    @task(1)
    def sequence_binary(self) -> None:
        """A motion, records."""
        body = {"adverbs": _named(_rows(1)[0])}
        no_rows = np.zeros((0, 3))
        self._post(
            "sequence", BINARY, lambda response: _checked_records(no_rows, response.content, measured=False), json=body
        )

    def _one(self) -> tuple[Numbers, float, bool]:
        """Adverbs, a phase, and whether it is the keytime's."""
        measured = RNG.random() < 0.5
        return _rows(1)[0], _keytime() if measured else RNG.random(), measured

    def _post(self, route: str, headers: dict[str, str], check: Callable[[Any], str | None], **body: Any) -> None:
        """Send a request and check the response."""
        if FOUND.goals is None:
            return
        name = f"{route}, {'binary' if headers['Accept'] == BINARY['Accept'] else 'JSON'}"
        requested = self.client.post(f"{self.path}/{route}", headers=headers, name=name, catch_response=True, **body)
        with requested as response:
            if response.status_code != 200:
                response.failure(f"{response.status_code}")
            elif (wrong := check(response)) is not None:
                response.failure(wrong)


def _rows(count: int) -> Numbers:
    """Adverbs (count, D) from the walk through the examples."""
    if FOUND.goals is None:
        return np.zeros((count, 3))
    rows = FOUND.goals.rows
    return rows[[RNG.randrange(len(rows)) for _ in range(count)]].astype(np.float64)


def _keytime() -> float:
    return FOUND.effector.phase if FOUND.effector is not None else 0.5


def _named(row: Numbers) -> dict[str, float]:
    return dict(zip(FOUND.goals.names, row.tolist(), strict=True)) if FOUND.goals is not None else {}


def _checked_json(rows: Numbers, poses: list[dict[str, Any]]) -> str | None:
    """Measure JSON poses at the keytime."""
    reported = [np.nan if pose["error"] is None else pose["error"] for pose in poses]
    return FOUND.measure(
        rows,
        np.array([pose["root"] for pose in poses]),
        np.array([pose["rotations"] for pose in poses]),
        np.array(reported),
        [pose["clamped"] for pose in poses],
    )


def _checked_records(rows: Numbers, content: bytes, *, measured: bool) -> str | None:
    """Check records, and measure them if they are at the keytime."""
    try:
        found = parse_records(content, FOUND.joints)
    except DecodeError as err:
        return err.detail
    if not measured:
        return None
    return FOUND.measure(
        rows,
        found["root"].astype(np.float64),
        found["rotations"].astype(np.float64),
        found["error"].astype(np.float64),
        found["flags"] & CLAMPED,
    )


for event, listener in (
    (events.init_command_line_parser, _options),
    (events.test_start, _prepare),
    (events.quitting, _summarise),
):
    event.add_listener(listener)  # type: ignore[no-untyped-call]  # Locust has no type here
