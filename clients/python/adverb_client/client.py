"""The blocking REST client."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self, TypeVar, Unpack

import httpx

from adverb_client import models
from adverb_client.api import Adverbs, Crowd, Numbers, Operation, PoseOptions, Request, Response, Track, error_of
from adverb_client.authoring_calls import AuthoringCalls
from adverb_client.authoring_models import Refinement
from adverb_client.errors import TimedOut, TransportError, Unavailable
from adverb_client.motion_api import EVENTS, events_path, refinements_of
from adverb_client.motion_calls import MotionCalls
from adverb_client.transport import POLL_S, BaseClient, auth_headers, httpx_request, response_of, transport_error

__all__ = ["Client"]

T = TypeVar("T")


class Client(AuthoringCalls, MotionCalls, BaseClient):
    """Blocking REST client. It may be shared by threads, and is a context manager.

    Parameters
    ----------
    url : str
        Address of the server.
    api_key : str, optional
    timeout_s : float
        Timeout of one request, seconds.
    retries : int
        Further attempts after status 429 or 503.
    max_wait_s : float
        Longest delay between two attempts, seconds, even if ``Retry-After`` is longer.
    transport : httpx.BaseTransport, optional
        Replaces the network.
    sleep : callable
        Waits for a number of seconds.

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
        max_wait_s: float = 2.0,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(retries, max_wait_s)
        self._sleep = sleep
        self._http = httpx.Client(base_url=url, headers=auth_headers(api_key), timeout=timeout_s, transport=transport)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close all connections."""
        self._http.close()

    def _run(self, operation: Operation[T]) -> T:
        try:
            request = next(operation)
            while True:
                request = operation.send(self._send(request))
        except StopIteration as done:
            found: T = done.value
            return found

    def _send(self, request: Request) -> Response:
        backoff = self._backoff()
        while True:
            response = self._send_once(request)
            wait_s = self._wait_s(request, response, backoff)
            if wait_s is None:
                return response
            self._sleep(wait_s)

    def _send_once(self, request: Request) -> Response:
        try:
            return response_of(self._http.send(httpx_request(self._http, request)))
        except (httpx.HTTPError, httpx.InvalidURL) as err:
            raise transport_error(err, self._http.base_url) from err

    def health(self) -> models.Health:
        """Readiness of the server; raises :class:`NotReady` without further attempts."""
        return self._run(self._api.health())

    def wait_ready(self, timeout_s: float = 120.0) -> models.Health:
        """Wait until the server is reachable and ready.

        Raises
        ------
        TimedOut
            If it is not ready in time.
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
        """The list of verbs."""
        return self._run(self._api.verbs())

    def verb(self, name: str) -> models.Verb:
        """The description of one verb."""
        return self._run(self._api.verb(name))

    def pose(
        self,
        verb: str,
        adverbs: Adverbs,
        *,
        phase: float | None = None,
        time_s: float | None = None,
        max_error: float | None = None,
        **options: Unpack[PoseOptions],
    ) -> models.Pose:
        """One pose of a verb.

        Parameters
        ----------
        verb : str
        adverbs : mapping or (D,) numbers
            By name, or all in the verb's order; in their units.
        phase, time_s : float, optional
            Canonical time, or seconds; the start by default.
        max_error : float, optional
            Largest acceptable error, metres: slower methods are tried until it is met. Implies ``full``.
        **options
            See :class:`PoseOptions`.

        Raises
        ------
        ResponseError
            If the server answers with an error.
        TransportError
            If the server cannot be reached.
        DecodeError
            If the response is malformed.
        """
        return self._run(self._api.pose(verb, adverbs, phase, time_s, max_error, options))

    def poses(
        self,
        verb: str,
        adverbs: Crowd,
        *,
        phases: Numbers | float | None = None,
        times_s: Numbers | float | None = None,
        **options: Unpack[PoseOptions],
    ) -> models.Poses:
        """Many poses of a verb in one request, binary in both directions.

        Parameters
        ----------
        verb : str
        adverbs : mapping or (B, D)
            A column (B,) per name, or rows in the verb's order.
        phases, times_s : (B,) or float, optional
            Canonical times, or seconds (sent as JSON, at most 1,000 poses); the start by default.
        **options
            See :class:`PoseOptions`.

        Raises
        ------
        ResponseError, TransportError, DecodeError
            As :meth:`pose`.
        """
        return self._run(self._api.poses(verb, adverbs, phases, times_s, options))

    def sequence(
        self,
        verb: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[PoseOptions],
    ) -> models.Sequence:
        """A whole motion, at constant adverbs or along a track of them.

        Parameters
        ----------
        verb : str
        adverbs : mapping or (D,) numbers, optional
        track : sequence of (seconds, adverbs), optional
            Interpolated linearly. Give this or ``adverbs``.
        fps : float
            Frames per second.
        cycles : int
            Number of cycles of a looping verb.
        **options
            See :class:`PoseOptions`; ``full=True`` adds the keytimes.

        Raises
        ------
        ResponseError, TransportError, DecodeError
            As :meth:`pose`.
        """
        return self._run(self._api.sequence(verb, adverbs, track, fps, cycles, options))

    def bvh(
        self,
        verb: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[PoseOptions],
    ) -> str:
        """A whole motion as the text of a BVH file, in metres and degrees; arguments as of :meth:`sequence`."""
        return self._run(self._api.bvh(verb, adverbs, track, fps, cycles, options))

    def follow_refinement(self, id: str) -> Iterator[Refinement]:
        """States of a refinement as they change, by server-sent events; ends with the refinement.

        Raises
        ------
        ResponseError, TransportError, DecodeError
            As :meth:`pose`; also if the connection breaks. ``wait_refinement`` polls instead.
        """
        try:
            with self._http.stream("GET", events_path(id), headers={"accept": EVENTS}, timeout=None) as response:
                if response.status_code != httpx.codes.OK:
                    response.read()
                    raise error_of(response_of(response))
                yield from refinements_of(response.iter_lines())
        except (httpx.HTTPError, httpx.InvalidURL) as err:
            raise transport_error(err, self._http.base_url) from err
