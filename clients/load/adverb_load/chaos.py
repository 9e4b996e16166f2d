"""Clients that misbehave: garbage, sudden ends, resumes, thefts, slow readers. The server must live and be right."""

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

from adverb_load import frames
from adverb_load.client import AIM, Asked, Player
from adverb_load.fleet import Fleet
from adverb_load.goals import CannotAsk, Goals, base_of, fetch
from adverb_load.tally import Clock, Tally, Track

__all__ = ["CODES", "Summary", "lines_of", "run"]

CODES = {
    "unknown_verb", "unknown_adverb", "unknown_joint", "unknown_method", "out_of_range", "bad_request", "not_ready",
    "bad_message", "unknown_channel", "channel_in_use", "too_many_channels", "skeleton_mismatch", "unknown_session",
}  # fmt: skip
"""Error codes of docs/wire.md; any other is a fault."""

CLOSES = {1000, 1001, 1002, 1006, 1007, 1009, 3000, 4008, 4009, 4029}
"""Codes with which connections of this client may end."""

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
    """What came of it.

    Parameters
    ----------
    messages, gaps, decode_errors, decoded, resumed : int
    done, codes, closes : dict
        Actions by name; error codes and close codes that were seen.
    faults : list of str
        What must not happen.
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
        """Whether the server came through."""
        return not self.faults

    def to_json(self) -> dict[str, object]:
        """Everything as JSON has it."""
        return dataclasses.asdict(self) | {"sound": self.sound}


@dataclass(slots=True)
class Rogue:
    """A client that misbehaves.

    Parameters
    ----------
    player : Player
    others : list of Rogue
    verbs : list of str
    done : Counter
    """

    player: Player
    others: list[Rogue]
    verbs: list[str]
    done: Counter[str]
    past: tuple[str, Track] | None = None

    @property
    def rng(self) -> random.Random:
        """Everything random."""
        return self.player.rng

    async def wander(self, end_s: float) -> None:
        """Do one thing after the other until the end."""
        names = list(ACTIONS)
        weights = [ACTIONS[name][0] for name in names]
        while time.monotonic() < end_s:
            if self.player.link is None or not self.player.link.alive:
                await self._come_back()
                continue
            name = self.rng.choices(names, weights)[0]
            self.done[name] += 1
            await ACTIONS[name][1](self)
            await asyncio.sleep(self.rng.uniform(0.0, 0.1))

    async def _come_back(self) -> None:
        """Connect again, as somebody new or with the session from before."""
        before = (self.player.session, self.player.track) if self.player.session else None
        try:
            await self.player.join()
        except (frames.FrameError, OSError, TimeoutError) as err:
            self.done[f"could not connect: {type(err).__name__}"] += 1
            await asyncio.sleep(0.2)
            return
        if before is not None and self.rng.random() < 0.7:
            self.done["come back"] += 1
            self.player.resume(*before)
        else:
            self.player.say(self.player.opening(0))

    def channel(self) -> int:
        """A channel, mostly one that is open."""
        known = list(self.player.layouts)
        return self.rng.choice(known) if known and self.rng.random() < 0.9 else self.rng.randrange(65_536)


# ── what a client may do ─────────────────────────────────────────────────────────────────────────────────────────


async def _open(rogue: Rogue) -> None:
    rng, player = rogue.rng, rogue.player
    other = {
        "fps": rng.choice([1, 24, 30, 60, 60, 90, 120]),
        "encoding": rng.choice(["f32", "q48", "weights"]),
        "space": rng.choice(["local", "global"]),
        "frame": rng.choice(["gltf", "unity", "unreal", "zup"]),
        "loop": rng.random() < 0.7,
        "speed": rng.choice([1.0, 1.0, -1.0, 0.0, 10.0]),
        "half_life": rng.choice([0.0, 0.1, 1.0]),
    }
    player.say(player.opening(rng.randrange(player.asked.channels), **other))


async def _close(rogue: Rogue) -> None:
    rogue.player.say({"op": "close", "channel": rogue.channel()})


async def _switch(rogue: Rogue) -> None:
    rng = rogue.rng
    verb = rng.choice([rogue.player.asked.verb, rng.choice(rogue.verbs)])
    asked = {"op": "switch", "channel": rogue.channel(), "verb": verb, "transition_s": rng.choice([0.0, 0.3, 5.0])}
    rogue.player.say(*[asked] * rng.choice([1, 1, 3]))


async def _set(rogue: Rogue) -> None:
    rng = rogue.rng
    changes = {
        "speed": rng.uniform(-10, 10),
        "phase": rng.random(),
        "play": rng.random() < 0.7,
        "fps": rng.randint(1, 120),
    }
    some = rng.sample(sorted(changes), rng.randint(1, len(changes)))
    rogue.player.say({"op": "set", "channel": rogue.channel()} | {name: changes[name] for name in some})


async def _steer(rogue: Rogue) -> None:
    for _ in range(rogue.rng.randint(1, 20)):
        rogue.player.steer()
        await asyncio.sleep(0.005)


async def _ping(rogue: Rogue) -> None:
    rogue.player.ping()


async def _pause(rogue: Rogue) -> None:
    link = rogue.player.link
    assert link is not None
    link.read(on=False)
    await asyncio.sleep(rogue.rng.uniform(0.1, 1.5))
    link.read(on=True)


# ── what it may not do ───────────────────────────────────────────────────────────────────────────────────────────


def _send(rogue: Rogue, opcode: int, payload: bytes) -> None:
    assert rogue.player.link is not None
    rogue.player.link.send(opcode, payload)


async def _odd_json(rogue: Rogue) -> None:
    _send(rogue, frames.TEXT, rogue.rng.choice(JSONS).encode("utf-8"))


async def _odd_text(rogue: Rogue) -> None:
    letters = 'ab{}[]":,0e-\\\n\0é漢🦶'
    _send(rogue, frames.TEXT, "".join(rogue.rng.choices(letters, k=rogue.rng.randrange(400))).encode())


async def _cut_json(rogue: Rogue) -> None:
    whole = json.dumps(rogue.player.opening(1)).encode()
    at = rogue.rng.randrange(len(whole))
    _send(rogue, frames.TEXT, rogue.rng.choice([whole[:at], whole[:at] + b"9" + whole[at + 1 :]]))


async def _odd_binary(rogue: Rogue) -> None:
    _send(rogue, frames.BINARY, rogue.rng.randbytes(rogue.rng.choice([0, 1, 3, 4, 8, 16, 17, 4_000])))


async def _odd_adverbs(rogue: Rogue) -> None:
    number = rogue.rng.choice([float("nan"), float("inf"), 3e38, -3e38, 1e-45])
    count = rogue.rng.choice([1, 2, 3, 3, 3, 4, 600])
    _send(rogue, frames.BINARY, struct.pack(f"<BBH{count}f", AIM, 0, rogue.channel(), *[number] * count))


async def _flood(rogue: Rogue) -> None:
    assert rogue.player.link is not None
    rogue.player.link.send(frames.TEXT, *[b'{"op": "dance"}'] * 400)


async def _no_text(rogue: Rogue) -> None:
    _send(rogue, frames.TEXT, b"\xff\xfe\xc3\x28")


async def _too_long(rogue: Rogue) -> None:
    _send(rogue, frames.BINARY, bytes(70_000))


async def _no_frame(rogue: Rogue) -> None:
    assert rogue.player.link is not None
    rogue.player.link.write(rogue.rng.choice([b"\x81\x02hi", rogue.rng.randbytes(60), b"GET / HTTP/1.1\r\n\r\n"]))


async def _vanish(rogue: Rogue) -> None:
    assert rogue.player.link is not None
    rogue.player.link.abort()
    await asyncio.sleep(rogue.rng.uniform(0.0, 0.8))


async def _leave(rogue: Rogue) -> None:
    assert rogue.player.link is not None
    rogue.player.link.close(rogue.rng.choice([1000, 1001, 3000]))
    await asyncio.sleep(0.1)


async def _dream(rogue: Rogue) -> None:
    rogue.player.resume("nobody", Track())


async def _steal(rogue: Rogue) -> None:
    victim = rogue.rng.choice(rogue.others).player
    if victim.session and victim.layouts:
        rogue.player.resume(victim.session, victim.track)


Action = Callable[[Rogue], Awaitable[None]]
ACTIONS: dict[str, tuple[float, Action]] = {
    "open": (10, _open),
    "close": (4, _close),
    "switch": (5, _switch),
    "set": (8, _set),
    "steer": (10, _steer),
    "ping": (3, _ping),
    "pause": (2, _pause),
    "odd JSON": (6, _odd_json),
    "odd text": (3, _odd_text),
    "cut JSON": (3, _cut_json),
    "odd binary": (3, _odd_binary),
    "odd adverbs": (3, _odd_adverbs),
    "flood": (0.3, _flood),
    "no text": (0.5, _no_text),
    "too long": (0.5, _too_long),
    "no frame": (0.5, _no_frame),
    "vanish": (2, _vanish),
    "leave": (1, _leave),
    "dream": (0.5, _dream),
    "steal": (0.5, _steal),
}
"""Weight and deed of everything a rogue does."""


# ── a run ────────────────────────────────────────────────────────────────────────────────────────────────────────


def run(asked: Asked, *, seconds: float) -> Summary:
    """Let rogues loose for some seconds; then see whether the server still serves.

    Raises
    ------
    CannotAsk
        If there is no server, or it does not have the verb.
    """
    return uvloop.run(_run(asked, seconds))


async def _run(asked: Asked, seconds: float) -> Summary:
    base = base_of(asked.url)
    goals = Goals.ask(base, asked.verb, np.random.default_rng(asked.seed))
    verbs = [verb["name"] for verb in fetch(base, "/v1/verbs")["verbs"]]
    asked = dataclasses.replace(asked, channels=max(asked.channels, 4))
    tally, clock, seeds, done = Tally(), Clock(), random.Random(asked.seed), Counter[str]()
    rogues: list[Rogue] = []
    for _ in range(asked.sockets):
        player = Player(asked, tally, clock, random.Random(seeds.getrandbits(64)), goals)
        rogues.append(Rogue(player, rogues, verbs, done))
    end_s = time.monotonic() + seconds
    async with asyncio.TaskGroup() as group:
        for rogue in rogues:
            group.create_task(rogue.wander(end_s))
    for rogue in rogues:
        if rogue.player.link is not None:
            rogue.player.link.abort()
    faults = [*_faults(tally), *await _still_serves(asked, goals)]
    return Summary(
        tally.messages,
        tally.gaps,
        tally.wrong,
        tally.decoded,
        sum(rogue.player.resumed for rogue in rogues),
        dict(sorted(done.items())),
        dict(sorted(tally.codes.items())),
        dict(sorted(tally.closes.items())),
        faults,
    )


def _faults(tally: Tally) -> list[str]:
    faults = []
    if tally.gaps:
        faults.append(f"{tally.gaps} messages are missing and were not reported")
    if tally.wrong:
        faults.append(f"{tally.wrong} messages cannot be read: {tally.problems}")
    faults += [f"error code {code}, which docs/wire.md does not have" for code in tally.codes.keys() - CODES]
    faults += [f"close code {code}, which is not expected" for code in tally.closes.keys() - CLOSES]
    return faults


async def _still_serves(asked: Asked, goals: Goals) -> list[str]:
    """What is wrong with a server that was mistreated: it must be ready, and serve two polite clients."""
    fleet = Fleet(dataclasses.replace(asked, sockets=2, channels=2), goals)
    try:
        if not fetch(base_of(asked.url), "/readyz").get("ready"):
            return ["the server is not ready any more"]
        await fleet.open()
        report = await fleet.measure(1.0, settle_s=0.3, probe=lambda: 0.0)
    except (CannotAsk, frames.FrameError, OSError, TimeoutError) as err:
        return [f"the server does not serve any more: {err or type(err).__name__}"]
    await fleet.close()
    if not report.sound or report.delivered < 0.8 * report.expected:
        return [f"polite clients got {report.delivered} of {report.expected} frames: {report.problems}"]
    return []


def lines_of(found: Summary) -> list[str]:
    """A summary for people."""
    return [
        f"done       {', '.join(f'{name} {count}' for name, count in found.done.items())}",
        f"frames     {found.messages}; {found.gaps} missing without a word",
        f"decoding   {found.decoded} messages read in full, {found.decode_errors} errors",
        f"resumed    {found.resumed}",
        f"errors     {', '.join(f'{code} {count}' for code, count in found.codes.items()) or 'none'}",
        f"closed     {', '.join(f'{code} {count}' for code, count in found.closes.items()) or 'none'}",
        *(f"fault      {fault}" for fault in found.faults),
        "the server came through" if found.sound else "the server did NOT come through",
    ]
