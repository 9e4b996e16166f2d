"""Any sequence of messages, legal or not: the session lives on, every mistake is named, no character is left over."""

import asyncio
import json
import struct
import time

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from service.app import create_app
from service.errors import PROBLEMS
from service.settings import Settings
from service.stream import messages

CHANNELS = st.integers(0, 4)
VERBS = st.sampled_from(["arm3", "reach", "board", "sway", "unknown"])
NUMBERS = st.floats(-3, 3) | st.sampled_from([1e12, float("nan"), 0])
ADVERBS = st.none() | st.dictionaries(st.sampled_from(["x", "y", "z", "u", "v", "width", "haste", "q"]), NUMBERS)
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)


class Wire:
    """The endpoint, spoken to in ASGI: the messages of uvicorn, without its socket."""

    def __init__(self, app, loop):
        self.loop, self.inbox, self.sent = loop, asyncio.Queue(), []
        self.engine = app.state.server.hub.engine
        scope = {
            **{
                "type": "websocket",
                "path": "/v1/stream",
                "raw_path": b"/v1/stream",
                "query_string": b"",
                "headers": [],
            },
            **{"scheme": "ws", "subprotocols": ["adverb.v1"], "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 80)},
            **{"headers": [], "root_path": "", "state": {}},
        }
        self.inbox.put_nowait({"type": "websocket.connect"})
        self.task = loop.create_task(app(scope, self.inbox.get, self.send))
        self.run()

    async def send(self, message):
        self.sent.append(message)

    def run(self):
        """Let the server do all there is to do."""

        async def turns():
            for _ in range(8):
                await asyncio.sleep(0)
                self.engine.handle(1.0)

        self.loop.run_until_complete(turns())

    def texts(self):
        return [json.loads(message["text"]) for message in self.sent if message.get("text")]

    def exchange(self, **content):
        """Send a message; return the replies."""
        self.sent.clear()
        self.inbox.put_nowait({"type": "websocket.receive", **content})
        self.run()
        return self.texts()

    def leave(self, code):
        self.inbox.put_nowait({"type": "websocket.disconnect", "code": code})
        self.run()


class Streams(RuleBasedStateMachine):
    """One server, one client that may vanish, and a model of which channels it has."""

    catalog = None

    def __init__(self):
        super().__init__()
        self.loop = asyncio.new_event_loop()
        self.app = create_app(Settings(stream_channels=3))
        self.state = self.app.state.server
        self.state.set_catalog(self.catalog)
        self.wire = Wire(self.app, self.loop)
        self.open = set()
        self.session = self.wire.texts()[0]["session"]

    def ask(self, **message):
        given = {key: value for key, value in message.items() if value is not None}
        answer = self.wire.exchange(text=json.dumps(given))
        return [text for text in answer if text["op"] in ("error", "opened", "pong")]

    def judge(self, answer, *, allowed):
        """At most one answer, and a mistake has a stable code."""
        assert len(answer) <= 1
        for text in answer:
            messages.SERVER.validate_json(json.dumps(text))
            if text["op"] == "error":
                assert text["code"] in PROBLEMS
                assert text["code"] != "internal_error"
                assert text["detail"]
        return not any(text["op"] == "error" for text in answer) and allowed

    @rule(channel=CHANNELS, verb=VERBS, adverbs=ADVERBS, fps=st.integers(0, 121), play=st.booleans(),
          encoding=st.sampled_from(["f32", "q48", "weights"]), half_life=st.sampled_from([0, 0.1, 3]))  # fmt: skip
    def opens(self, channel, verb, adverbs, fps, play, encoding, half_life):
        answer = self.ask(op="open", channel=channel, verb=verb, adverbs=adverbs or None, fps=fps, play=play,
                          encoding=encoding, half_life=half_life)  # fmt: skip
        assert len(answer) == 1
        if self.judge(answer, allowed=channel not in self.open):
            self.open.add(channel)

    @rule(channel=CHANNELS, adverbs=ADVERBS, speed=st.none() | NUMBERS, phase=st.none() | NUMBERS,
          fps=st.none() | st.integers(0, 121), play=st.none() | st.booleans())  # fmt: skip
    def sets(self, channel, adverbs, speed, phase, fps, play):
        answer = self.ask(
            op="set", channel=channel, adverbs=adverbs or None, speed=speed, phase=phase, fps=fps, play=play
        )
        self.judge(answer, allowed=True)
        assert answer or channel in self.open

    @rule(channel=CHANNELS, verb=VERBS, adverbs=ADVERBS, transition_s=st.sampled_from([0, 0.3, 5, 6]))
    def switches(self, channel, verb, adverbs, transition_s):
        answer = self.ask(op="switch", channel=channel, verb=verb, adverbs=adverbs or None, transition_s=transition_s)
        assert len(answer) == 1
        self.judge(answer, allowed=True)

    @rule(channel=CHANNELS)
    def closes(self, channel):
        answer = self.ask(op="close", channel=channel)
        assert bool(answer) == (channel not in self.open)
        self.open.discard(channel)

    @rule(channel=CHANNELS, row=st.lists(st.floats(width=32), max_size=4))
    def aims(self, channel, row):
        content = struct.pack(f"<BBH{len(row)}f", 0x10, 0, channel, *row)
        self.judge([text for text in self.wire.exchange(bytes=content) if text["op"] == "error"], allowed=True)

    @rule(content=st.binary(max_size=40))
    def babbles(self, content):
        self.judge([text for text in self.wire.exchange(bytes=content) if text["op"] == "error"], allowed=True)

    @rule(content=ANYTHING, op=st.sampled_from(["open", "set", "switch", "close", "ping", "resume", "dance"]))
    def rambles(self, content, op):
        message = {**content, "op": op} if isinstance(content, dict) else content
        answer = [text for text in self.wire.exchange(text=json.dumps(message)) if text["op"] in ("error", "pong")]
        assert len(answer) == 1
        assert answer[0]["op"] == "pong" or answer[0]["code"] == "bad_message"

    @rule(t=st.floats(allow_nan=False, allow_infinity=False))
    def pings(self, t):
        assert [text["t"] for text in self.ask(op="ping", t=t)] == [t]

    @rule(seconds=st.sampled_from([0.0, 0.02, 1.0, 100.0]))
    def time_passes(self, seconds):
        hub = self.state.hub
        hub.ticks.origin_s -= seconds
        hub.idle(time.monotonic())
        start_s = hub.start_s()
        if start_s is not None and start_s <= time.monotonic():
            hub.send(hub.prepare())
        self.wire.run()

    @rule(code=st.sampled_from([1006, 1011]))
    def vanishes_and_resumes(self, code):
        self.wire.leave(code)
        assert self.wire.task.done()
        self.wire = Wire(self.app, self.loop)
        answer = self.ask(op="resume", session=self.session, last_seq=0)
        if self.open:
            assert {text["channel"] for text in answer} == self.open
            assert all(text["resumed"] for text in answer)
        else:  # a session without channels is not kept
            assert [text["code"] for text in answer] == ["unknown_session"]
            self.session = next(iter(self.state.hub.sessions))

    @invariant()
    def nothing_is_left_over(self):
        hub = self.state.hub
        assert not self.wire.task.done()
        assert {number for session in hub.sessions.values() for number in session.channels} == self.open
        assert hub.characters == len(self.open) <= 3
        assert sum(len(group.characters) for group in hub.channels.groups.values()) == len(self.open)
        assert len(hub.sessions) == 1

    def teardown(self):
        self.wire.leave(1000)
        hub = self.state.hub
        assert not hub.sessions
        assert hub.characters == 0
        assert hub.connections == 0
        hub._sweep(time.monotonic())
        assert not hub._connections
        self.loop.close()


@pytest.mark.usefixtures("_quiet")
def test_no_sequence_of_messages_breaks_a_session(catalog):
    Streams.catalog = catalog
    state = type("State", (Streams,), {}).TestCase
    state.settings = settings(
        max_examples=60, stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck)
    )
    state("runTest").runTest()
