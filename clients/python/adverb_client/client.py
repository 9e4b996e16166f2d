"""The REST client that waits for its answers."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self, TypeVar, Unpack

import httpx

from adverb_client import models
from adverb_client.api import Adverbs, Answer, Call, Crowd, Numbers, Options, Question, Track
from adverb_client.errors import TimedOut, TransportError, Unavailable
from adverb_client.transport import POLL_S, Shared, answer_of, failed, headers_of, request_of

__all__ = ["Client"]

T = TypeVar("T")


class Client(Shared):
    """A client that waits for answers. May be shared by threads, and used as a context manager.

    Parameters
    ----------
    url : str
        Where the server is.
    api_key : str, optional
    timeout_s : float
        Longest wait for one answer.
    retries : int
        How often to ask again where the server answers 503.
    longest_wait_s : float
        Longest wait between two tries, whatever ``Retry-After`` says.
    transport : httpx.BaseTransport, optional
        Instead of a socket.
    sleep : callable
        Waits for so many seconds.

    Examples
    --------
    >>> with Client("http://127.0.0.1:8000") as client:
    ...     pose = client.pose("reach", {"x": -0.3, "y": 1.2, "z": 0.4}, phase=0.5)
    ...     print(pose.error)
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:8000",
        *,
        api_key: str | None = None,
        timeout_s: float = 10.0,
        retries: int = 3,
        longest_wait_s: float = 2.0,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(retries, longest_wait_s)
        self._sleep = sleep
        self._http = httpx.Client(base_url=url, headers=headers_of(api_key), timeout=timeout_s, transport=transport)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close all connections."""
        self._http.close()

    def _run(self, question: Question[T]) -> T:
        try:
            call = next(question)
            while True:
                call = question.send(self._answered(call))
        except StopIteration as done:
            found: T = done.value
            return found

    def _answered(self, call: Call) -> Answer:
        backoff = self._backoff()
        while True:
            answer = self._once(call)
            wait_s = self._wait_s(call, answer, backoff)
            if wait_s is None:
                return answer
            self._sleep(wait_s)

    def _once(self, call: Call) -> Answer:
        try:
            return answer_of(self._http.send(request_of(self._http, call)))
        except (httpx.HTTPError, httpx.InvalidURL) as err:
            raise failed(err, self._http.base_url) from err

    def health(self) -> models.Health:
        """Whether the server is ready; raises :class:`NotReady` where it is not yet, without asking again."""
        return self._run(self._asking.health())

    def wait_ready(self, timeout_s: float = 120.0) -> models.Health:
        """Wait until the server is there and ready.

        Raises
        ------
        TimedOut
            If it is not within the time.
        """
        end = time.monotonic() + timeout_s
        while True:
            try:
                return self.health()
            except (TransportError, Unavailable) as err:
                if time.monotonic() + POLL_S > end:
                    raise TimedOut(f"not ready within {timeout_s:g} s: {err}") from err
            self._sleep(POLL_S)

    def verbs(self) -> tuple[models.VerbSummary, ...]:
        """The verbs that are served."""
        return self._run(self._asking.verbs())

    def verb(self, name: str) -> models.Verb:
        """All about one verb."""
        return self._run(self._asking.verb(name))

    def pose(
        self,
        verb: str,
        adverbs: Adverbs,
        *,
        phase: float | None = None,
        time_s: float | None = None,
        max_error: float | None = None,
        **options: Unpack[Options],
    ) -> models.Pose:
        """One pose of a verb.

        Parameters
        ----------
        verb : str
        adverbs : mapping or (D,) numbers
            By name, or all in the verb's order; in their units.
        phase, time_s : float, optional
            Canonical time, or seconds; the start where neither is given.
        max_error : float, optional
            What error is good enough, metres: slower methods are tried until it is met. Makes the answer a full one.
        **options
            See :class:`Options`.

        Raises
        ------
        Refused
            If the server says no.
        TransportError
            If it cannot be reached.
        DecodeError
            If its answer cannot be read.
        """
        return self._run(self._asking.pose(verb, adverbs, phase, time_s, max_error, options))

    def poses(
        self,
        verb: str,
        adverbs: Crowd,
        *,
        phases: Numbers | float | None = None,
        times_s: Numbers | float | None = None,
        **options: Unpack[Options],
    ) -> models.Poses:
        """Many poses of a verb in one call, binary in and out.

        Parameters
        ----------
        verb : str
        adverbs : mapping or (B, D)
            A column (B,) per name, or rows in the verb's order.
        phases, times_s : (B,) or float, optional
            Canonical times, or seconds (which go out as JSON, at most 1,000 poses); the start where neither is given.
        **options
            See :class:`Options`.

        Raises
        ------
        Refused, TransportError, DecodeError
            As :meth:`pose`.
        """
        return self._run(self._asking.poses(verb, adverbs, phases, times_s, options))

    def sequence(
        self,
        verb: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[Options],
    ) -> models.Sequence:
        """A whole motion, at constant adverbs or along a track of them.

        Parameters
        ----------
        verb : str
        adverbs : mapping or (D,) numbers, optional
        track : sequence of (seconds, adverbs), optional
            Linear between the points. Give this or ``adverbs``.
        fps : float
            Frames per second.
        cycles : int
            Of a verb that loops.
        **options
            See :class:`Options`; ``full=True`` tells the keytimes that pass, too.

        Raises
        ------
        Refused, TransportError, DecodeError
            As :meth:`pose`.
        """
        return self._run(self._asking.sequence(verb, adverbs, track, fps, cycles, options))

    def bvh(
        self,
        verb: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[Options],
    ) -> str:
        """A whole motion as the text of a BVH file, in metres and degrees; arguments as of :meth:`sequence`."""
        return self._run(self._asking.bvh(verb, adverbs, track, fps, cycles, options))
