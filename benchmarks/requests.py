"""CPU per request of the pose route, against a FastAPI route that validates the same body and answers constant bytes.

Both run in this process, called through the ASGI interface without sockets, so that only application code is counted;
process time is measured, in turns, and the least of many rounds is taken. A crowd is one request for a binary batch.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from fastapi import FastAPI, Response

from service.access.keys import hash_of, new
from service.app import create_app
from service.http.request_models import PoseRequest
from service.run import logs
from service.settings import Settings
from service.store.keys import open_keys

BODY = orjson.dumps({"adverbs": {"x": -0.2, "y": 1.2, "z": 0.5}, "phase": 0.4})
JSON, OCTETS = b"application/json", b"application/octet-stream"
CROWD = 10_000


def crowd() -> bytes:
    """Rows of adverbs and phase."""
    rng = np.random.default_rng(0)
    low, high = (-0.4, 1.0, 0.3, 0.0), (0.2, 1.5, 0.6, 1.0)
    return rng.uniform(low, high, (CROWD, 4)).astype("<f4").tobytes()


async def ask(app: Any, path: str, accept: bytes, content: bytes = BODY, kind: bytes = JSON, key: str = "") -> bytes:
    """One POST through the ASGI interface."""
    parts: list[bytes] = []
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "POST", "scheme": "http",
        "path": path, "raw_path": path.encode(), "query_string": b"", "root_path": "", "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 80), "state": {}, "headers": [
            (b"host", b"localhost"), (b"content-type", kind), (b"accept", accept),
            (b"content-length", str(len(content)).encode()),
            *([(b"authorization", f"Bearer {key}".encode())] if key else []),
        ],
    }  # fmt: skip

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": content, "more_body": False}

    async def send(message: Any) -> None:
        if message["type"] == "http.response.start" and message["status"] != 200:
            raise RuntimeError(f"the answer has status {message['status']}")
        if message["type"] == "http.response.body":
            parts.append(message.get("body", b""))

    await app(scope, receive, send)
    return b"".join(parts)


def baseline(answer: bytes, media: str) -> FastAPI:
    """A route that validates the same body and answers the same number of bytes."""
    app = FastAPI(openapi_url=None)

    @app.post("/v1/verbs/{verb}/pose")
    async def pose(verb: str, request: PoseRequest) -> Response:
        return Response(answer, media_type=media)

    return app


async def measure(asks: dict[str, Callable[[], Any]], rounds: int = 30, each: int = 200) -> dict[str, float]:
    """Least CPU microseconds per request, in turns."""
    best = dict.fromkeys(asks, float("inf"))
    for _ in range(rounds):
        for name, one in asks.items():
            started = time.process_time()
            for _ in range(each):
                await one()
            best[name] = min(best[name], 1e6 * (time.process_time() - started) / each)
    return best


async def run() -> None:
    """Print one table."""
    logs.configure(Settings(log_level="warning"))
    app = create_app(Settings())
    path, binary, text, rows = "/v1/verbs/reach/pose", OCTETS, JSON, crowd()
    async with app.router.lifespan_context(app):
        for _ in range(1_200):
            if b"true" in await ready(app):
                break
            await asyncio.sleep(0.1)
        plain = {accept: baseline(await ask(app, path, accept), accept.decode()) for accept in (binary, text)}
        best = await measure(
            {
                "pose, binary": lambda: ask(app, path, binary),
                "constant, binary": lambda: ask(plain[binary], path, binary),
                "pose, JSON": lambda: ask(app, path, text),
                "constant, JSON": lambda: ask(plain[text], path, text),
            }
        )
        many = await measure(
            {"crowd": lambda: ask(app, "/v1/verbs/reach/poses", OCTETS, rows, OCTETS)}, rounds=20, each=1
        )
    print("CPU per request, µs (application code, no sockets)")
    for name, value in best.items():
        print(f"  {name:<20}{value:>8.1f}")
    print(f"  binary / constant: {best['pose, binary'] / best['constant, binary']:.2f}×   (goal ≤ 1.15)")
    print(f"  JSON / constant:   {best['pose, JSON'] / best['constant, JSON']:.2f}×   (goal ≤ 1.2)")
    await guarded()
    print(f"  {CROWD:,} poses in one binary request: {many['crowd'] / CROWD:.2f} µs a pose")


async def guarded() -> None:
    """What a key with limits on its rate, and traces, cost a pose, beside a server with neither."""
    path = "/v1/verbs/reach/pose"
    with tempfile.TemporaryDirectory() as without, tempfile.TemporaryDirectory() as folder:
        settings = Settings(data=Path(folder), refiners=0)
        keys = open_keys(settings.database)
        id, key = new()
        keys.add(id, hash_of(key), name="", scopes=frozenset({"pose"}), expires_at_s=None)
        keys.close()
        rate = "1000000/second"
        plain, closed, traced = (
            create_app(settings.model_copy(update={"data": Path(without)})),
            create_app(settings.model_copy(update={"rate_per_key": rate})),
            create_app(Settings(refiners=0, traces_url="http://127.0.0.1:9", traces_share=0.0)),
        )
        async with AsyncExitStack() as stack:
            for app in (plain, closed, traced):
                await stack.enter_async_context(app.router.lifespan_context(app))
                while b"true" not in await ready(app):  # noqa: ASYNC110 - the server has no event for it
                    await asyncio.sleep(0.1)
            best = await measure(
                {
                    "open": lambda: ask(plain, path, OCTETS),
                    "key": lambda: ask(closed, path, OCTETS, key=key),
                    "traced": lambda: ask(traced, path, OCTETS),
                }
            )
    print(f"  with a key and a rate: {best['key']:.1f} µs, {best['key'] / best['open']:.3f}× of a server without")
    print(f"  with traces, not recorded: {best['traced'] / best['open']:.3f}×")


async def ready(app: Any) -> bytes:
    """Body of the readiness route."""
    from httpx import ASGITransport, AsyncClient

    async with AsyncClient(transport=ASGITransport(app), base_url="http://localhost") as client:
        return (await client.get("/readyz")).content


def main() -> None:
    """Run the comparison."""
    asyncio.run(run())


if __name__ == "__main__":
    main()
