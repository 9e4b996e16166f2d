"""What both REST clients do alike: calls → httpx requests, answers, errors and waits."""

from __future__ import annotations

import httpx

from adverb_client.api import Answer, Asking, Call, refused
from adverb_client.backoff import Backoff
from adverb_client.errors import TimedOut, TransportError

__all__ = ["POLL_S", "Shared", "answer_of", "failed", "headers_of", "request_of"]

POLL_S = 0.2
"""How often a server that is not ready yet is asked again."""


class Shared:
    """What both clients do alike."""

    def __init__(self, retries: int, longest_wait_s: float) -> None:
        self._asking = Asking()
        self._retries, self._longest_wait_s = retries, longest_wait_s

    def _wait_s(self, call: Call, answer: Answer, backoff: Backoff) -> float | None:
        """How long to wait before asking again; None where the answer stands."""
        if answer.status != 503 or not call.patient or backoff.failures >= self._retries:
            return None
        return backoff.next_s(refused(answer).retry_after_s)

    def _backoff(self) -> Backoff:
        return Backoff(longest_s=self._longest_wait_s)


def headers_of(api_key: str | None) -> dict[str, str]:
    """Headers of all requests."""
    return {"authorization": f"Bearer {api_key}"} if api_key else {}


def _sent(call: Call) -> dict[str, str]:
    headers = {"accept": call.accept, **call.headers}
    return headers | ({"content-type": call.content_type} if call.content_type else {})


def request_of(http: httpx.Client | httpx.AsyncClient, call: Call) -> httpx.Request:
    """A call as httpx sends it."""
    query = httpx.QueryParams(call.query) if call.query else None
    return http.build_request(call.method, call.path, content=call.content, headers=_sent(call), params=query)


def answer_of(response: httpx.Response) -> Answer:
    """A response, read."""
    return Answer(
        response.status_code, {name.lower(): value for name, value in response.headers.items()}, response.content
    )


def failed(err: httpx.HTTPError | httpx.InvalidURL, url: httpx.URL) -> TransportError:
    """The error of this package for one of httpx."""
    kind = TimedOut if isinstance(err, httpx.TimeoutException) else TransportError
    return kind(f"{url}: {type(err).__name__}: {err}".rstrip(": "))
