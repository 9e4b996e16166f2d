"""The figure: one channel of a stream that walks, and switches to a verb that meets a ball."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from actions import Action, choose, stand_for
from adverb_client import AdverbError, Channel, Client, Pose, Record, Sample, SyncStream
from adverb_client.records import CLAMPED, IN_TRANSITION, LAST
from balls import CAUGHT, FLYING, MISSED, STRUCK, Ball, closest
from placement import Placement, yaw_of

F64 = npt.NDArray[np.float64]

WALK = "locomotion"
FPS = 60
TRANSITION_S = 0.3
LEAD_S = 0.05
"""From a switch to its first frame."""

REACH_M = 0.14
"""A ball is met if the effector comes so near to its middle: its radius, and that of a hand."""

WINDOW = 0.12
"""Phases around the keytime in which a ball can be met."""

LATE_S = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A received frame: game time of its tick, verb, the record, and its root (3,) and rotations (J, 4)."""

    time_s: float
    verb: str
    record: Record
    root: F64
    rotations: F64


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a ball: its verb, the distance, m (NaN if none was measured), when, s, and whether it was met."""

    verb: str
    miss_m: float
    when_s: float
    met: bool
    clamped: bool


@dataclass(slots=True, eq=False)
class Attempt:
    """A ball that is being met."""

    ball: Ball
    action: Action
    goal: F64
    near: list[Frame] = field(default_factory=list)
    switched: Future[object] | None = None
    posed: tuple[Frame, Future[Pose]] | None = None
    calibrated: bool = False
    result: Result | None = None


class Fighter:
    """The figure.

    Parameters
    ----------
    stream : SyncStream
    client : Client
        Of the same server.
    thrower : (3,)
        Where balls come from.
    game_s : callable
        Game time of a time on the stream's clock: it stands still while the game is paused.
    on_result : callable
        Takes the results.
    """

    def __init__(
        self, stream: SyncStream, client: Client, thrower: F64, game_s: Callable[[float], float],
        on_result: Callable[[Ball, Result], None],
    ) -> None:  # fmt: skip
        self.stream, self.client, self._thrower, self._game_s, self._report = stream, client, thrower, game_s, on_result
        self.actions = {name: Action.fetch(client, name) for name in ("punch", "kick", "reach")}
        self.channel: Channel = stream.open(WALK, fps=FPS, half_life=0.06, adverbs=_walk(0.0, 0.0, 0.0))
        self._frames: deque[Frame] = deque(maxlen=600)
        self.channel.observers.append(self._add)
        self._pool = ThreadPoolExecutor(1, "game requests")
        self.last: Frame | None = None
        self.attempt: Attempt | None = None
        self.errors = 0
        self.doing = "stands"
        self._back: Future[object] | None = None

    def close(self) -> None:
        """End the requests."""
        self._pool.shutdown(cancel_futures=True)

    def _add(self, due_s: float, record: Record) -> None:
        """Keep a frame; called by the stream's thread."""
        clock = self.stream.clock
        if clock.known and record.root is not None and record.rotations is not None:
            time_s, turns = self._game_s(due_s - clock.offset_s), record.rotations.astype(np.float64)
            self._frames.append(Frame(time_s, self.channel.verb, record, record.root.astype(np.float64), turns))

    @property
    def position(self) -> F64:
        """Position (3,) of the root on the ground."""
        root = np.zeros(3) if self.last is None else self.last.root
        return np.array([root[0], 0.0, root[2]])

    @property
    def heading(self) -> float:
        """Where the figure faces, radians about +Y from +Z."""
        return 0.0 if self.last is None else yaw_of(self.last.rotations[0])

    def sample(self) -> Sample | None:
        """The pose to display."""
        return self.channel.pose()

    def effector(self, frame: Frame, joint: int) -> F64:
        """Position (3,) of a joint in a frame, by forward kinematics."""
        return np.asarray(self.channel.skeleton.positions(frame.root, frame.rotations)[joint])

    # ── every tick ───────────────────────────────────────────────────────────────────────────────────────────────

    def update(self, now_s: float, balls: list[Ball]) -> None:
        """Take the new frames; walk to the next ball, or meet it."""
        while self._frames:
            frame = self._frames.popleft()
            self.last = frame
            if self.attempt is not None:
                self._watch(self.attempt, frame)
        if self.attempt is not None:
            self._go_on(self.attempt, now_s)
            return
        flying = [ball for ball in balls if ball.state == FLYING]
        ball = min(flying, key=lambda ball: ball.meet_s, default=None)
        if not self._walking():
            return
        if ball is None:
            self.doing = "stands"
            self.channel.aim([0.0, 0.0, 0.0])
            return
        action = self.actions[choose(ball)]
        if now_s >= ball.meet_s - action.time_s - LEAD_S:
            self._begin(ball, action)
        else:
            self._walk(ball, action)

    def _walking(self) -> bool:
        """Whether the channel walks; switches back to that if it does not."""
        if self.channel.verb == WALK:
            self._back = None
            return True
        if self._back is None or self._done(self._back) is not None:
            self._back = self._pool.submit(
                self.stream.switch, self.channel, WALK, adverbs=_walk(0.0, 0.0, 0.0), transition_s=0.4
            )
        return False

    def _walk(self, ball: Ball, action: Action) -> None:
        """Steer to where the ball can be met."""
        stand, heading = stand_for(action.verb, ball.meet, self._thrower)
        ahead = Placement(self.heading, self.position).local(stand)
        turn = math.remainder(heading - self.heading, 2.0 * math.pi)
        far = float(np.hypot(ahead[0], ahead[2]))
        self.doing = "walks" if far > 0.1 else "waits"
        speeds = np.clip([2.2 * ahead[2], 2.5 * turn, 2.2 * ahead[0]], [-0.65, -1.4, -0.95], [2.5, 1.4, 0.95])
        self.channel.aim(speeds.tolist())

    def _begin(self, ball: Ball, action: Action) -> None:
        """Switch to the verb; where it will stand is known nearly, from the last frame."""
        if self.last is None:
            return
        placement = action.placement(self.last.root, self.last.rotations[0], action.first)
        goal = action.goal(placement, ball.meet)
        self.attempt = Attempt(ball, action, goal)
        self.doing = {"punch": "punches", "kick": "kicks", "reach": "catches"}[action.verb]
        adverbs = dict(zip("xyz", goal.tolist(), strict=True))
        self.attempt.switched = self._pool.submit(
            self.stream.switch, self.channel, action.verb, adverbs=adverbs, phase=0.0, transition_s=TRANSITION_S
        )

    # ── a ball is met ────────────────────────────────────────────────────────────────────────────────────────────

    def _watch(self, attempt: Attempt, frame: Frame) -> None:
        """Use a frame of the attempt: to find the exact placement, and near the keytime to measure."""
        action, record = attempt.action, frame.record
        if frame.verb != action.verb:
            return
        if not attempt.calibrated and attempt.posed is None and not record.flags & IN_TRANSITION:
            attempt.posed = (
                frame,
                self._pool.submit(self.client.pose, action.verb, attempt.goal.tolist(), phase=record.phase),
            )
        if abs(record.phase - action.phase) < WINDOW:
            attempt.near.append(frame)
        if attempt.result is None and (record.phase >= action.phase + WINDOW or record.flags & LAST):
            self._measure(attempt)

    def _go_on(self, attempt: Attempt, now_s: float) -> None:
        if attempt.switched is not None and isinstance(self._done(attempt.switched), AdverbError):
            self._finish(attempt, Result(attempt.action.verb, math.nan, math.nan, met=False, clamped=False))
            self.attempt = None
            return
        if attempt.posed is not None:
            frame, answer = attempt.posed
            found = self._done(answer)
            if isinstance(found, Pose):
                self._correct(attempt, frame, found)
            if found is not None:
                attempt.posed, attempt.calibrated = None, True
        if attempt.result is None and now_s > attempt.ball.meet_s + LATE_S:
            self._measure(attempt)
        last = self.last
        over = last is not None and last.verb == attempt.action.verb and last.record.phase > 0.9
        if attempt.result is not None and (over or now_s > attempt.ball.meet_s + 2.0 * LATE_S):
            self.attempt = None
        elif attempt.result is not None and attempt.ball.state == CAUGHT and last is not None:
            attempt.ball.at = self.effector(last, attempt.action.effector)

    def _correct(self, attempt: Attempt, frame: Frame, pose: Pose) -> None:
        """Aim again with the exact placement, and arrive in time."""
        record, action = frame.record, attempt.action
        placement = action.placement(frame.root, frame.rotations[0], pose)
        attempt.goal = action.goal(placement, attempt.ball.meet)
        self.channel.aim(attempt.goal.tolist())
        left_s, motion_s = attempt.ball.meet_s - frame.time_s, action.time_s - record.time_s
        if left_s > 0.05 and motion_s > 0.05:
            self.channel.set(speed=float(np.clip(motion_s / left_s, 0.6, 1.7)))

    def _measure(self, attempt: Attempt) -> None:
        """How near the effector came to the ball, from the frames around the keytime."""
        near, ball, action = attempt.near, attempt.ball, attempt.action
        self.channel.set(speed=1.0)
        if not near:
            self._finish(attempt, Result(action.verb, math.nan, math.nan, met=False, clamped=False))
            return
        times_s = np.array([frame.time_s for frame in near])
        points = np.stack([self.effector(frame, action.effector) for frame in near])
        miss_m, when_s, point = closest(times_s, points, ball)
        clamped = any(frame.record.flags & CLAMPED for frame in near)
        met = miss_m < REACH_M
        if met:
            velocity = (points[-1] - points[0]) / max(float(times_s[-1] - times_s[0]), 1e-3)
            ball.end(CAUGHT if ball.soft else STRUCK, when_s, point, 1.5 * velocity + [0.0, 0.8, 1.5])
        self._finish(attempt, Result(action.verb, miss_m, when_s, met, clamped))

    def _finish(self, attempt: Attempt, result: Result) -> None:
        attempt.result = result
        if not result.met:
            attempt.ball.state = MISSED
        self._report(attempt.ball, result)

    def _done(self, future: Future[object] | Future[Pose]) -> object | None:
        """Result or error of a request; None while it runs."""
        if not future.done():
            return None
        problem = future.exception()
        if problem is None:
            return future.result()
        if not isinstance(problem, AdverbError):
            raise problem
        self.errors += 1
        return problem


def _walk(forward: float, turn: float, sideways: float) -> dict[str, float]:
    return {"forward_speed": forward, "turn_rate": turn, "sideways_speed": sideways}
