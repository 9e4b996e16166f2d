"""Common parts of both REST clients: conversion to and from httpx, errors, retries."""

from __future__ import annotations

import httpx

from adverb_client.api import Api, Request, Response, error_of
from adverb_client.authoring_api import AuthoringApi
from adverb_client.backoff import Backoff
from adverb_client.errors import TimedOut, TransportError
from adverb_client.motion_api import MotionApi

__all__ = ["POLL_S", "BaseClient", "auth_headers", "httpx_request", "response_of", "transport_error"]

POLL_S = 0.2
"""Interval between two checks of a server that is not ready."""


class BaseClient:
    """Base class of both REST clients: retry policy and API state."""

    def __init__(self, retries: int, max_wait_s: float) -> None:
        self._api, self._authoring = Api(), AuthoringApi()
        self._motions = MotionApi(self._api)
        self._retries, self._max_wait_s = retries, max_wait_s

    def _wait_s(self, request: Request, response: Response, backoff: Backoff) -> float | None:
        """Delay before the next attempt, seconds; None if the response is final."""
        if response.status not in (429, 503) or not request.retry or backoff.failures >= self._retries:
            return None
        return backoff.next_s(error_of(response).retry_after_s)

    def _backoff(self) -> Backoff:
        return Backoff(max_s=self._max_wait_s)


def auth_headers(api_key: str | None) -> dict[str, str]:
    """Headers of all requests."""
    return {"authorization": f"Bearer {api_key}"} if api_key else {}


def _request_headers(request: Request) -> dict[str, str]:
    headers = {"accept": request.accept, **request.headers}
    return headers | ({"content-type": request.content_type} if request.content_type else {})


def httpx_request(http: httpx.Client | httpx.AsyncClient, request: Request) -> httpx.Request:
    """The httpx request of a request."""
    query = httpx.QueryParams(request.query) if request.query else None
    return http.build_request(
        request.method,
        request.path,
        content=request.content,
        headers=_request_headers(request),
        params=query,
        timeout=httpx.USE_CLIENT_DEFAULT if request.timeout_s is None else request.timeout_s,
    )


def response_of(response: httpx.Response) -> Response:
    """The response of an httpx response."""
    return Response(
        response.status_code, {name.lower(): value for name, value in response.headers.items()}, response.content
    )


def transport_error(err: httpx.HTTPError | httpx.InvalidURL, url: httpx.URL) -> TransportError:
    """The error of this package for an httpx error."""
    kind = TimedOut if isinstance(err, httpx.TimeoutException) else TransportError
    return kind(f"{url}: {type(err).__name__}: {err}".rstrip(": "))
