"""Clients that misbehave: malformed messages, aborts, stolen sessions, slow readers. The server must survive."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import random
import struct
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import numpy as np
import uvloop
from adverb_client import Clock
from adverb_client.wire import ADVERBS, BULK_ADVERBS, encode_bulk_adverbs

from adverb_load import frames
from adverb_load.client import Load, LoadClient
from adverb_load.fleet import Fleet
from adverb_load.goals import Goals, RequestError, base_of, fetch
from adverb_load.tally import Tally, Track

__all__ = ["CODES", "Summary", "lines_of", "run"]

CODES = {
    "unknown_verb", "unknown_adverb", "unknown_joint", "unknown_method", "out_of_range", "bad_request", "not_ready",
    "bad_message", "unknown_channel", "channel_in_use", "too_many_channels", "skeleton_mismatch", "unknown_session",
}  # fmt: skip
"""Error codes of docs/wire.md; another one is a fault."""

CLOSES = {1000, 1001, 1002, 1006, 1007, 1009, 3000, 4008, 4009, 4029}
"""Expected close codes."""

JSONS = [
    "", "{", "[]", "null", "7", '"open"', "{}", '{"op": 3}', '{"op": "dance"}', '{"op": "open"}', "[" * 9_000,
    '{"op":' * 900,
    '{"op": "open", "channel": -1, "verb": "reach"}', '{"op": "open", "channel": 1e400, "verb": "reach"}',
    '{"op": "open", "channel": 70000, "verb": "reach"}', '{"op": "open", "channel": 1, "verb": "no such verb"}',
    '{"op": "open", "channel": 2, "verb": "reach", "adverbs": {"x": NaN}}',
    '{"op": "open", "channel": 2, "verb": "reach", "adverbs": {"q": 1}}',
    '{"op": "open", "channel": 2, "verb": "reach", "joints": ["Tail"]}',
    '{"op": "open", "channel": 2, "verb": "reach", "method": "magic"}',
    '{"op": "open", "channel": 2, "verb": "reach", "fps": 100000}',
    '{"op": "open", "channel": 2, "verb": "\\ud800"}', '{"op": "open", "channel": 2, "verb": "reach", "more": 1}',
    '{"op": "set", "channel": 65535, "speed": 2}', '{"op": "close", "channel": 65534}', '{"op": "ping", "t": "now"}',
    '{"op": "ping", "t": 1e999}',
    '{"op": "resume", "session": "", "last_seq": -1}', '{"op": "switch", "channel": 3, "verb": "arm3"}',
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Summary:
    """Result of a run.

    Parameters
    ----------
    messages, gaps, decode_errors, decoded, resumed : int
    done, codes, closes : dict
        Actions by name; error codes and close codes.
    faults : list of str
        Violations by the server.
    """

    messages: int
    gaps: int
    decode_errors: int
    decoded: int
    resumed: int
    done: dict[str, int]
    codes: dict[str, int]
    closes: dict[int, int]
    faults: list[str]

    @property
    def sound(self) -> bool:
        """Whether the server survived without faults."""
        return not self.faults

    def to_json(self) -> dict[str, object]:
        """The summary as a JSON object."""
        return dataclasses.asdict(self) | {"sound": self.sound}


@dataclass(slots=True)
class ChaosClient:
    """A client that misbehaves.

    Parameters
    ----------
    client : LoadClient
    others : list of ChaosClient
    verbs : list of str
    done : Counter
    """

    client: LoadClient
    others: list[ChaosClient]
    verbs: list[str]
    done: Counter[str]
    past: tuple[str, Track] | None = None

    @property
    def rng(self) -> random.Random:
        """The client's random generator."""
        return self.client.rng

    async def wander(self, end_s: float) -> None:
        """Perform random actions until the end."""
        names = list(ACTIONS)
        weights = [ACTIONS[name][0] for name in names]
        while time.monotonic() < end_s:
            if self.client.socket is None or not self.client.socket.alive:
                await self._reconnect()
                continue
            name = self.rng.choices(names, weights)[0]
            self.done[name] += 1
            await ACTIONS[name][1](self)
            await asyncio.sleep(self.rng.uniform(0.0, 0.1))

    async def _reconnect(self) -> None:
        """Connect again, with a new session or the previous one."""
        before = (self.client.session, self.client.track) if self.client.session else None
        try:
            await self.client.join()
        except (frames.FrameError, OSError, TimeoutError) as err:
            self.done[f"failed to connect: {type(err).__name__}"] += 1
            await asyncio.sleep(0.2)
            return
        if before is not None and self.rng.random() < 0.7:
            self.done["resume"] += 1
            self.client.resume(*before)
        else:
            self.client.send(self.client.open_message(0))

    def channel(self) -> int:
        """A channel, mostly one that is open."""
        known = list(self.client.layouts)
        return self.rng.choice(known) if known and self.rng.random() < 0.9 else self.rng.randrange(65_536)


# ── valid actions ────────────────────────────────────────────────────────────────────────────────────────────────


async def _open(actor: ChaosClient) -> None:
    rng, client = actor.rng, actor.client
    other = {
        "fps": rng.choice([1, 24, 30, 60, 60, 90, 120]),
        "encoding": rng.choice(["f32", "q48", "q32", "weights"]),
        "space": rng.choice(["local", "global"]),
        "frame": rng.choice(["gltf", "unity", "unreal", "zup"]),
        "loop": rng.random() < 0.7,
        "speed": rng.choice([1.0, 1.0, -1.0, 0.0, 10.0]),
        "half_life": rng.choice([0.0, 0.1, 1.0]),
    }
    client.send(client.open_message(rng.randrange(client.load.channels), **other))


async def _close(actor: ChaosClient) -> None:
    actor.client.send({"op": "close", "channel": actor.channel()})


async def _switch(actor: ChaosClient) -> None:
    rng = actor.rng
    verb = rng.choice([actor.client.load.verb, rng.choice(actor.verbs)])
    load = {"op": "switch", "channel": actor.channel(), "verb": verb, "transition_s": rng.choice([0.0, 0.3, 5.0])}
    actor.client.send(*[load] * rng.choice([1, 1, 3]))


async def _set(actor: ChaosClient) -> None:
    rng = actor.rng
    changes = {
        "speed": rng.uniform(-10, 10),
        "phase": rng.random(),
        "play": rng.random() < 0.7,
        "fps": rng.randint(1, 120),
    }
    some = rng.sample(sorted(changes), rng.randint(1, len(changes)))
    actor.client.send({"op": "set", "channel": actor.channel()} | {name: changes[name] for name in some})


async def _steer(actor: ChaosClient) -> None:
    for _ in range(actor.rng.randint(1, 20)):
        actor.client.steer()
        await asyncio.sleep(0.005)


async def _steer_many(actor: ChaosClient) -> None:
    goals, channels = actor.client.goals, list(actor.client.layouts)
    for message in encode_bulk_adverbs(channels, goals.rows[: len(channels)]) if goals is not None and channels else ():
        _send(actor, frames.BINARY, message)


async def _ping(actor: ChaosClient) -> None:
    actor.client.ping()


async def _pause(actor: ChaosClient) -> None:
    socket = actor.client.socket
    assert socket is not None
    socket.read(on=False)
    await asyncio.sleep(actor.rng.uniform(0.1, 1.5))
    socket.read(on=True)


# ── invalid actions ──────────────────────────────────────────────────────────────────────────────────────────────


def _send(actor: ChaosClient, opcode: int, payload: bytes) -> None:
    assert actor.client.socket is not None
    actor.client.socket.send(opcode, payload)


async def _odd_json(actor: ChaosClient) -> None:
    _send(actor, frames.TEXT, actor.rng.choice(JSONS).encode("utf-8"))


async def _odd_text(actor: ChaosClient) -> None:
    letters = 'ab{}[]":,0e-\\\n\0é漢🦶'
    _send(actor, frames.TEXT, "".join(actor.rng.choices(letters, k=actor.rng.randrange(400))).encode())


async def _cut_json(actor: ChaosClient) -> None:
    whole = json.dumps(actor.client.open_message(1)).encode()
    at = actor.rng.randrange(len(whole))
    _send(actor, frames.TEXT, actor.rng.choice([whole[:at], whole[:at] + b"9" + whole[at + 1 :]]))


async def _odd_binary(actor: ChaosClient) -> None:
    _send(actor, frames.BINARY, actor.rng.randbytes(actor.rng.choice([0, 1, 3, 4, 8, 16, 17, 4_000])))


async def _odd_adverbs(actor: ChaosClient) -> None:
    number = actor.rng.choice([float("nan"), float("inf"), 3e38, -3e38, 1e-45])
    count = actor.rng.choice([1, 2, 3, 3, 3, 4, 600])
    _send(actor, frames.BINARY, struct.pack(f"<BBH{count}f", ADVERBS, 0, actor.channel(), *[number] * count))


async def _odd_many(actor: ChaosClient) -> None:
    rng = actor.rng
    width, rows = rng.choice([0, 1, 3, 3, 3, 16]), rng.choice([0, 1, 2, 100])
    row = struct.pack(f"<HH{width}f", actor.channel(), 0, *[rng.choice([0.0, 0.3, float("nan"), 3e38])] * width)
    count = rng.choice([rows, rows, rows + 1, 0, 65_535])
    _send(actor, frames.BINARY, struct.pack("<BBH", BULK_ADVERBS, 0, count) + rows * row + bytes(rng.choice([0, 0, 3])))


async def _flood(actor: ChaosClient) -> None:
    assert actor.client.socket is not None
    actor.client.socket.send(frames.TEXT, *[b'{"op": "dance"}'] * 400)


async def _no_text(actor: ChaosClient) -> None:
    _send(actor, frames.TEXT, b"\xff\xfe\xc3\x28")


async def _too_long(actor: ChaosClient) -> None:
    _send(actor, frames.BINARY, bytes(70_000))


async def _no_frame(actor: ChaosClient) -> None:
    assert actor.client.socket is not None
    actor.client.socket.write(actor.rng.choice([b"\x81\x02hi", actor.rng.randbytes(60), b"GET / HTTP/1.1\r\n\r\n"]))


async def _vanish(actor: ChaosClient) -> None:
    assert actor.client.socket is not None
    actor.client.socket.abort()
    await asyncio.sleep(actor.rng.uniform(0.0, 0.8))


async def _leave(actor: ChaosClient) -> None:
    assert actor.client.socket is not None
    actor.client.socket.close(actor.rng.choice([1000, 1001, 3000]))
    await asyncio.sleep(0.1)


async def _dream(actor: ChaosClient) -> None:
    actor.client.resume("unknown", Track())


async def _steal(actor: ChaosClient) -> None:
    victim = actor.rng.choice(actor.others).client
    if victim.session and victim.layouts:
        actor.client.resume(victim.session, victim.track)


Action = Callable[[ChaosClient], Awaitable[None]]
ACTIONS: dict[str, tuple[float, Action]] = {
    "open": (10, _open),
    "close": (4, _close),
    "switch": (5, _switch),
    "set": (8, _set),
    "steer": (10, _steer),
    "steer many": (5, _steer_many),
    "ping": (3, _ping),
    "pause": (2, _pause),
    "odd JSON": (6, _odd_json),
    "odd text": (3, _odd_text),
    "cut JSON": (3, _cut_json),
    "odd binary": (3, _odd_binary),
    "odd adverbs": (3, _odd_adverbs),
    "odd many": (3, _odd_many),
    "flood": (0.3, _flood),
    "no text": (0.5, _no_text),
    "too long": (0.5, _too_long),
    "no frame": (0.5, _no_frame),
    "vanish": (2, _vanish),
    "leave": (1, _leave),
    "dream": (0.5, _dream),
    "steal": (0.5, _steal),
}
"""Weight and function of each action."""


# ── a run ────────────────────────────────────────────────────────────────────────────────────────────────────────


def run(load: Load, *, seconds: float) -> Summary:
    """Run misbehaving clients for some seconds, then check that the server still serves.

    Raises
    ------
    RequestError
        If there is no server, or it does not have the verb.
    """
    return uvloop.run(_run(load, seconds))


async def _run(load: Load, seconds: float) -> Summary:
    base = base_of(load.url)
    goals = Goals.fetch(base, load.verb, np.random.default_rng(load.seed))
    verbs = [verb["name"] for verb in fetch(base, "/v1/verbs")["verbs"]]
    load = dataclasses.replace(load, channels=max(load.channels, 4))
    tally, clock, seeds, done = Tally(), Clock(), random.Random(load.seed), Counter[str]()
    actors: list[ChaosClient] = []
    for _ in range(load.sockets):
        client = LoadClient(load, tally, clock, random.Random(seeds.getrandbits(64)), goals)
        actors.append(ChaosClient(client, actors, verbs, done))
    end_s = time.monotonic() + seconds
    async with asyncio.TaskGroup() as group:
        for actor in actors:
            group.create_task(actor.wander(end_s))
    for actor in actors:
        if actor.client.socket is not None:
            actor.client.socket.abort()
    faults = [*_faults(tally), *await _check_service(load, goals)]
    return Summary(
        tally.messages,
        tally.gaps,
        tally.wrong,
        tally.decoded,
        sum(actor.client.resumed for actor in actors),
        dict(sorted(done.items())),
        dict(sorted(tally.codes.items())),
        dict(sorted(tally.closes.items())),
        faults,
    )


def _faults(tally: Tally) -> list[str]:
    faults = []
    if tally.gaps:
        faults.append(f"{tally.gaps} messages are missing and not reported")
    if tally.wrong:
        faults.append(f"{tally.wrong} messages are malformed or implausible: {tally.problems}")
    faults += [f"error code {code}, which docs/wire.md does not have" for code in tally.codes.keys() - CODES]
    faults += [f"close code {code}, which is not expected" for code in tally.closes.keys() - CLOSES]
    return faults


async def _check_service(load: Load, goals: Goals) -> list[str]:
    """Faults of the server afterwards: it must be ready and serve two regular clients."""
    fleet = Fleet(dataclasses.replace(load, sockets=2, channels=2), goals)
    try:
        if not fetch(base_of(load.url), "/readyz").get("ready"):
            return ["the server is not ready afterwards"]
        await fleet.open()
        report = await fleet.measure(1.0, settle_s=0.3, probe=lambda: 0.0)
    except (RequestError, frames.FrameError, OSError, TimeoutError) as err:
        return [f"the server does not serve afterwards: {err or type(err).__name__}"]
    await fleet.close()
    if not report.sound or report.delivered < 0.8 * report.expected:
        return [f"regular clients received {report.delivered} of {report.expected} frames: {report.problems}"]
    return []


def lines_of(found: Summary) -> list[str]:
    """The summary as lines of text."""
    return [
        f"done       {', '.join(f'{name} {count}' for name, count in found.done.items())}",
        f"frames     {found.messages}; {found.gaps} missing unreported",
        f"decoding   {found.decoded} messages decoded in full, {found.decode_errors} errors",
        f"resumed    {found.resumed}",
        f"errors     {', '.join(f'{code} {count}' for code, count in found.codes.items()) or 'none'}",
        f"closed     {', '.join(f'{code} {count}' for code, count in found.closes.items()) or 'none'}",
        *(f"fault      {fault}" for fault in found.faults),
        "the server survived" if found.sound else "the server did NOT survive",
    ]
