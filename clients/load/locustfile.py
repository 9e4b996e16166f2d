"""Load on a server's REST routes, with Locust; what the poses reach is measured again here.

    locust -f clients/load/locustfile.py --headless --host http://127.0.0.1:8000 -u 8 -r 8 -t 10s --only-summary

or ``python clients/load/rest.py``. Of the requests for one pose and for many, those at the effector's keytime are
measured: forward kinematics of the answer, and its distance from what was asked.
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
from adverb_load.effector import Reach
from adverb_load.goals import CannotAsk, Goals, fetch
from locust import FastHttpUser, between, events, task

CROWD, ROWS = 20, 200
"""Poses of a JSON and of a binary batch."""

AGREE = 1e-4
"""How far this measurement may be from the server's own, metres: poses are 32-bit floats."""

BINARY = {"Accept": "application/octet-stream"}
JSON = {"Accept": "application/json"}
HEAD = [
    ("channel", "<u2"),
    ("encoding", "u1"),
    ("flags", "u1"),
    ("version", "<u4"),
    ("phase", "<f4"),
    ("time", "<f4"),
    ("error", "<f4"),
    ("duration", "<f4"),
]
CLAMPED = 1

Numbers = npt.NDArray[np.float64]


@dataclass(slots=True)
class Found:
    """What is known of the verb, and what was measured of its poses.

    Parameters
    ----------
    goals : Goals or None
    reach : Reach or None
        None where the verb is not measured by an effector's place.
    record : dtype or None
        A binary record.
    errors, apart : list of float
        Errors that were measured here; distance from those that the server says.
    clamped, disagreed : int
        Poses outside the domain, which are not measured; poses whose error differs by too much.
    """

    goals: Goals | None = None
    reach: Reach | None = None
    record: np.dtype[np.void] | None = None
    errors: list[float] = field(default_factory=list)
    apart: list[float] = field(default_factory=list)
    clamped: int = 0
    disagreed: int = 0
    started_s: float = 0.0

    def measure(self, asked: Numbers, root: Numbers, rotations: Numbers, said: Numbers, clamped: Any) -> str | None:
        """Measure poses (B,) at the effector's keytime; what is wrong with them."""
        if self.reach is None:
            return None
        inside = ~np.asarray(clamped, bool)
        self.clamped += int(np.count_nonzero(~inside))
        errors = self.reach.errors(asked, root, rotations)[inside]
        apart = np.abs(errors - said[inside])
        self.errors += errors.tolist()
        self.apart += apart.tolist()
        wrong = int(np.count_nonzero(apart > AGREE))
        self.disagreed += wrong
        return f"{wrong} poses are {apart.max():.4g} m from the error that the server says" if wrong else None


FOUND = Found()
RNG = random.Random(1)


def _options(parser: Any) -> None:
    """What can be asked for beside Locust's own."""
    parser.add_argument("--verb", default="reach", env_var="ADVERB_LOAD_VERB", help="verb to ask for")


def _learn(environment: Any, **_: Any) -> None:
    """Read all about the verb."""
    options = environment.parsed_options
    path = f"/v1/verbs/{quote(options.verb, safe='')}"
    try:
        verb = fetch(environment.host.rstrip("/"), path)
    except CannotAsk as err:
        sys.stderr.write(f"error: {err}\n")
        environment.process_exit_code = 2
        environment.runner.quit()
        return
    joints = len(verb["skeleton"]["names"])
    FOUND.goals = Goals.of(verb, np.random.default_rng(1))
    FOUND.reach = Reach.of(verb)
    FOUND.record = np.dtype([*HEAD, ("root", "<f4", (3,)), ("rotations", "<f4", (joints, 4))])
    FOUND.started_s = time.monotonic()


def _tell(environment: Any, **_: Any) -> None:
    """Print what came of it."""
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
            f"error      mean {np.mean(FOUND.errors):.3g}  max {np.max(FOUND.errors):.3g} m, measured here over "
            f"{len(FOUND.errors)} poses; {FOUND.clamped} outside the domain were left out",
            f"agreement  within {np.max(FOUND.apart):.3g} m of what the server says; {FOUND.disagreed} poses beyond "
            f"{AGREE:g} m",
        ]
    else:
        lines.append("error      not measured: the verb's adverbs are not an effector's x, y, z")
    sys.stdout.write("\n".join(lines) + "\n")


class Animator(FastHttpUser):
    """A client that asks for poses, batches and motions, as JSON and as binary records."""

    wait_time = between(0.0, 0.01)

    def on_start(self) -> None:
        """Learn the address."""
        options = self.environment.parsed_options
        self.path = f"/v1/verbs/{quote(options.verb if options else 'reach', safe='')}"

    @task(10)
    def pose(self) -> None:
        """One pose, JSON."""
        row, phase, measured = self._one()
        body = {"adverbs": _named(row), "phase": phase}

        def check(answer: Any) -> str | None:
            return _checked_json(row[None], [answer.json()]) if measured else None

        self._post("pose", JSON, check, json=body)

    @task(10)
    def pose_binary(self) -> None:
        """One pose, a record."""
        row, phase, measured = self._one()
        body = {"adverbs": _named(row), "phase": phase}

        def check(answer: Any) -> str | None:
            return _checked_records(row[None], answer.content, measured=measured)

        self._post("pose", BINARY, check, json=body)

    @task(4)
    def poses(self) -> None:
        """A small crowd, JSON."""
        rows, phase = _rows(CROWD), _keytime()
        body = {"items": [{"adverbs": _named(row), "phase": phase} for row in rows]}
        self._post("poses", JSON, lambda answer: _checked_json(rows, answer.json()["poses"]), json=body)

    @task(4)
    def poses_binary(self) -> None:
        """A large crowd, rows in and records out."""
        rows = _rows(ROWS)
        body = np.concatenate([rows, np.full((ROWS, 1), _keytime())], axis=1).astype("<f4").tobytes()
        headers = BINARY | {"Content-Type": "application/octet-stream"}
        self._post("poses", headers, lambda answer: _checked_records(rows, answer.content, measured=True), data=body)

    @task(1)
    def sequence(self) -> None:
        """A motion, JSON."""
        body = {"adverbs": _named(_rows(1)[0])}
        self._post("sequence", JSON, lambda answer: None if answer.json()["frames"] else "no frames", json=body)

    @task(1)
    def sequence_binary(self) -> None:
        """A motion, records."""
        body = {"adverbs": _named(_rows(1)[0])}
        nobody = np.zeros((0, 3))
        self._post(
            "sequence", BINARY, lambda answer: _checked_records(nobody, answer.content, measured=False), json=body
        )

    def _one(self) -> tuple[Numbers, float, bool]:
        """Adverbs, a phase, and whether it is the keytime's."""
        measured = RNG.random() < 0.5
        return _rows(1)[0], _keytime() if measured else RNG.random(), measured

    def _post(self, route: str, headers: dict[str, str], check: Callable[[Any], str | None], **body: Any) -> None:
        """Ask, and doubt the answer."""
        if FOUND.goals is None:
            return
        name = f"{route}, {'binary' if headers['Accept'] == BINARY['Accept'] else 'JSON'}"
        asked = self.client.post(f"{self.path}/{route}", headers=headers, name=name, catch_response=True, **body)
        with asked as answer:
            if answer.status_code != 200:
                answer.failure(f"{answer.status_code}")
            elif (wrong := check(answer)) is not None:
                answer.failure(wrong)


def _rows(count: int) -> Numbers:
    """Adverbs (count, D) from the walk through the examples."""
    if FOUND.goals is None:
        return np.zeros((count, 3))
    rows = FOUND.goals.rows
    return rows[[RNG.randrange(len(rows)) for _ in range(count)]].astype(np.float64)


def _keytime() -> float:
    return FOUND.reach.phase if FOUND.reach is not None else 0.5


def _named(row: Numbers) -> dict[str, float]:
    return dict(zip(FOUND.goals.names, row.tolist(), strict=True)) if FOUND.goals is not None else {}


def _checked_json(rows: Numbers, poses: list[dict[str, Any]]) -> str | None:
    """What is wrong with poses at the keytime."""
    said = [np.nan if pose["error"] is None else pose["error"] for pose in poses]
    return FOUND.measure(
        rows,
        np.array([pose["root"] for pose in poses]),
        np.array([pose["rotations"] for pose in poses]),
        np.array(said),
        [pose["clamped"] for pose in poses],
    )


def _checked_records(rows: Numbers, content: bytes, *, measured: bool) -> str | None:
    """What is wrong with records; they are measured if they are those of the keytime."""
    record = FOUND.record
    if record is None or not content or len(content) % record.itemsize:
        return f"{len(content)} bytes are no records"
    found = np.frombuffer(content, record)
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
    (events.test_start, _learn),
    (events.quitting, _tell),
):
    event.add_listener(listener)  # type: ignore[no-untyped-call]  # Locust says nothing of types here
