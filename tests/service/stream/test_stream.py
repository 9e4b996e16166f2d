"""The protocol of docs/wire.md, message by message, over a real socket."""

import asyncio
import json
import math
import struct
import time
from itertools import pairwise

import httpx
import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from service.settings import Settings
from service.stream import messages
from service.stream.endpoint import MAX_CONSECUTIVE, _Reader
from tests.service.stream.conftest import eventually, open_stream
from verbs.kernels import quat

pytestmark = pytest.mark.anyio

CLAMPED, IN_TRANSITION, NEW_VERSION, LAST = 1, 2, 4, 8
REACH = {"x": -0.3, "y": 1.2, "z": 0.45}
NEAR = {"x": -0.1, "y": 1.1, "z": 0.45}
ARM = {"x": 0.4, "y": 0.3}


def angle(one, other):
    one, other = np.asarray(one, np.float64), np.asarray(other, np.float64)
    chord = np.minimum(np.linalg.norm(one - other, axis=-1), np.linalg.norm(one + other, axis=-1))
    return float((4 * np.arcsin(chord / 2)).max())


def passed(client):
    """Names of the keytimes of all events."""
    return [item["name"] for text in client.texts if text["op"] == "events" for item in text["items"]]


async def ask(server, verb, **body):
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{server.port}") as client:
        answer = await client.post(f"/v1/verbs/{verb}/pose", json=body)
        return answer.raise_for_status().json()


async def test_hello_names_the_session_the_clock_and_the_limits(server):
    async with open_stream(server) as client:
        assert client.socket.subprotocol == "adverb.v1"
        assert len(client.hello["session"]) >= 20
        assert abs(client.hello["server_time_ns"] - time.time_ns()) < 2e9
        assert client.hello["max_channels"] == 2048
        assert client.hello["grace_s"] == 10.0


async def test_very_many_mistakes_of_a_message_are_counted_only(server):
    async with open_stream(server) as client:
        await client.send("set", channel=1, **dict.fromkeys((f"k{number}" for number in range(5_000)), 1))
        error = await client.until("error")
        assert error["detail"] == "5000 mistakes; some are listed where there are at most 200"


async def test_long_messages_of_a_client_leave_the_event_loop_to_others():
    """A client whose next message is always there: other tasks run after each long one, and after 32 short ones."""

    class Idle:
        posted, backlog, pending = 0, 0, False

    class Nothing:
        handle, settings = None, Settings()

        def post(self, *_):
            pass

    for text, most in (("x" * 65_536, 1), ("x", MAX_CONSECUTIVE)):
        messages = [{"type": "websocket.receive", "text": text}] * 100 + [{"type": "websocket.disconnect"}]
        read, reads = iter(messages), [0]

        async def receive(read=read, reads=reads):
            reads[-1] += 1
            return next(read)

        task = asyncio.create_task(_Reader(Nothing(), Idle()).run(receive))
        while not task.done():
            reads.append(0)
            await asyncio.sleep(0)
        assert sum(reads) == 101
        assert max(reads) <= most + 1


async def test_only_our_subprotocol_is_echoed(server):
    async with connect(server.url, subprotocols=["adverb.v1", "adverb.bearer.abc"]) as socket:
        assert socket.subprotocol == "adverb.v1"


async def test_records_have_the_support_of_their_channel_where_it_is_requested(server):
    async with open_stream(server) as client:
        await client.open(1, "reach", adverbs=REACH, play=False, follow=False, support=True)
        await client.open(2, "reach", adverbs=NEAR, play=False, follow=False)
        (frame,) = await client.poses(1)
        expected = (await ask(server, "reach", adverbs=REACH))["support"]
        assert ((frame.of(1).flags >> 4) - 1) / 14 == pytest.approx(expected, abs=0.5 / 14 + 1e-9)
        assert frame.of(2).flags >> 4 == 0
        await client.socket.send(json.dumps({"op": "switch", "channel": 1, "verb": "punch"}))
        frames = await client.poses(40)
        assert frames[-1].of(1).flags >> 4 > 0


async def test_a_held_channel_shows_the_pose_that_rest_gives(server):
    async with open_stream(server) as client:
        opened = await client.open(7, "reach", adverbs=REACH, phase=0.3, play=False, follow=False)
        (frame,) = await client.poses(1)
        record = frame.of(7)
        expected = await ask(server, "reach", adverbs=REACH, phase=0.3)
    assert opened["joints"] == opened["skeleton"]["names"]
    assert opened["record_bytes"] == 24 + 12 + 16 * len(opened["joints"])
    np.testing.assert_allclose(record.root, expected["root"], atol=1e-6)
    np.testing.assert_allclose(record.rotations, expected["rotations"], atol=1e-6)
    assert record.phase == pytest.approx(0.3)
    assert record.time == pytest.approx(expected["time"], abs=1e-5)
    assert record.duration == pytest.approx(expected["duration"], abs=1e-5)
    assert record.error == pytest.approx(expected["error"], abs=1e-7)
    assert record.flags == 0


async def test_everything_the_server_says_fits_the_published_schema(server):
    async with open_stream(server) as client:
        await client.open(1, "reach", adverbs=REACH, phase=0.45, speed=10)
        await client.until("end")
        await client.send("ping", t=0.25)
        await client.until("pong")
        await client.send("close", channel=9)
        await client.until("error")
        for text in client.texts:
            messages.SERVER.validate_json(json.dumps(text))
        assert {text["op"] for text in client.texts} == {"hello", "opened", "events", "end", "pong", "error"}


@pytest.mark.parametrize("fps", [120, 60, 25, 7])
async def test_frames_come_on_an_absolute_schedule(server, fps):
    async with open_stream(server) as client:
        await client.open(1, "arm3", adverbs=ARM, fps=fps)
        frames = await client.poses(max(4, fps // 3))
    ticks = np.diff([frame.time_ns for frame in frames]) * fps / 1e9
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-6)
    assert np.median(ticks) == pytest.approx(1.0)
    assert [frame.sequence for frame in frames] == list(range(1, len(frames) + 1))
    missed = round(float(np.sum(np.round(ticks) - 1)))  # by a busy machine, and then counted
    assert frames[-1].dropped - frames[0].dropped == missed


async def test_channels_of_a_socket_share_messages(server):
    async with open_stream(server) as client:
        for channel, fps in ((1, 60), (2, 60), (3, 30)):
            await client.open(channel, "arm3", fps=fps)
        frames = (await client.poses(20))[4:]
    numbers = [[record.channel for record in frame.records] for frame in frames]
    assert numbers.count([1, 2, 3]) + numbers.count([1, 2]) == len(numbers)
    assert min(numbers.count([1, 2, 3]), numbers.count([1, 2])) >= 4


async def test_time_runs_as_asked(server):
    async with open_stream(server) as client:
        await client.open(1, "arm3", adverbs=ARM, fps=100, speed=0.5)
        frames = await client.poses(10)
        passed = (frames[-1].time_ns - frames[0].time_ns) / 1e9
        assert frames[-1].of(1).time - frames[0].of(1).time == pytest.approx(0.5 * passed, abs=1e-5)
        await client.send("set", channel=1, play=False, phase=0.5)
        frames = [frame.of(1).phase for frame in await client.poses(20)]
        assert frames[-5:] == [0.5] * 5
        await client.send("set", channel=1, play=True, speed=-1)
        phases = [frame.of(1).phase for frame in await client.poses(20)]
        assert phases[-1] < phases[-5] < 0.5


async def test_keytimes_pass_and_a_motion_ends_once(server):
    async with open_stream(server) as client:
        await client.open(1, "reach", adverbs=REACH, speed=8, fps=120)
        await client.until("end")
        await client.for_seconds(0.1)
    assert passed(client) == ["start", "apex", "end"]
    assert client.texts[-1] == {"op": "end", "channel": 1}
    flagged = [frame for frame in client.frames if frame.of(1).flags & LAST]
    assert len(flagged) == 1
    assert flagged[0].of(1).phase == 1.0
    assert client.frames[-1].of(1).phase == 1.0


async def test_played_backwards_it_ends_at_the_start(server):
    async with open_stream(server) as client:
        await client.open(1, "reach", speed=-10, phase=1.0, fps=120)
        await client.until("end")
        assert passed(client) == ["end", "apex", "start"]


async def test_a_loop_goes_on_through_the_world(server):
    async with open_stream(server) as client:
        await client.open(1, "sway", speed=4, fps=60)
        frames = await client.poses(60)
    records = [frame.of(1) for frame in frames]
    phases = np.array([record.phase for record in records])
    ahead = np.array([math.hypot(record.root[0], record.root[2]) for record in records])
    assert (np.diff(phases) < 0).sum() >= 2
    assert phases.max() < 1.0
    assert ahead[-1] > 1.0
    assert np.diff(ahead).min() > -0.005
    assert all(math.isnan(record.error) for record in records)


async def test_a_motion_that_does_not_loop_can_start_over(server):
    async with open_stream(server) as client:
        await client.open(1, "reach", adverbs=REACH, loop=True, phase=0.95, fps=60)
        frames = await client.poses(40)
    flags = [frame.of(1).flags for frame in frames]
    assert IN_TRANSITION in flags
    assert flags[-1] == 0
    assert not any(text["op"] == "end" for text in client.texts)


async def test_adverbs_are_run_after_smoothly(server):
    async with open_stream(server) as client:
        opened = await client.open(1, "arm3", adverbs={"x": 0.2, "y": 0.2}, phase=0.4, play=False, half_life=0.05)
        await client.poses(2)
        await client.set_adverbs(1, 0.6, 0.4)
        frames = await client.poses(60)
    steps = [angle(a.of(1).rotations, b.of(1).rotations) for a, b in pairwise(frames)]
    assert max(steps) < 0.35
    assert max(steps) > 0.01
    assert steps[-1] < 1e-3
    expected = await ask(server, "arm3", adverbs={"x": 0.6, "y": 0.4}, phase=0.4)
    assert opened["follow"][0] <= 0.4 <= opened["follow"][1]
    assert angle(frames[-1].of(1).rotations, np.array(expected["rotations"])) < 1.0
    assert frames[-1].of(1).error < 1e-6


async def test_many_channels_are_steered_by_one_message_or_none_is(server):
    rows = {4: (0.5, 0.1), 9: (0.2, 0.3), 2: (0.4, 0.2)}
    async with open_stream(server) as client:
        for number in rows:
            await client.open(number, "arm3", adverbs=ARM, fps=1)
        await client.open(3, "reach", fps=1)
        channels = server.hub.sessions[client.hello["session"]].channels

        def goals():
            return {number: channels[number].group.characters.goals[channels[number].slot].tolist() for number in rows}

        def message(rows):
            cells = b"".join(struct.pack("<HH2f", number, 0, *row) for number, row in rows.items())
            return struct.pack("<BBH", 0x11, 0, len(rows)) + cells

        await client.socket.send(message(rows))
        await client.send("ping", t=1)
        await client.until("pong")
        assert goals() == {number: pytest.approx(row) for number, row in rows.items()}
        before = goals()
        for wrong in ({3: (0.1, 0.1)}, {8: (0.1, 0.1)}, {9: (0.1, math.nan)}):
            await client.socket.send(message({4: (0.6, 0.2), **wrong, 2: (0.1, 0.3)}))
            assert (await client.until("error"))["channel"] in wrong
        assert goals() == before


async def test_half_life_zero_is_at_once(server):
    async with open_stream(server) as client:
        await client.open(1, "arm3", adverbs={"x": 0.2, "y": 0.2}, phase=0.1, play=False, half_life=0)
        await client.poses(1)
        await client.send("set", channel=1, adverbs={"x": 0.6})
        frames = await client.poses(20)
    expected = await ask(server, "arm3", adverbs={"x": 0.6, "y": 0.2}, phase=0.1)
    np.testing.assert_allclose(frames[-1].of(1).rotations, expected["rotations"], atol=1e-6)
    shown = {frame.of(1).rotations.tobytes() for frame in frames}
    assert len(shown) <= 2


async def test_encodings_agree(server):
    async with open_stream(server) as client:
        names = ["RightHand", "Hips", "Head"]
        fields = {"adverbs": REACH, "phase": 0.4, "play": False, "follow": False}
        full = await client.open(1, "reach", **fields)
        packed = await client.open(2, "reach", encoding="q48", **fields)
        weights = await client.open(3, "reach", encoding="weights", **fields)
        some = await client.open(4, "reach", encoding="q48", joints=names, space="global", **fields)
        frame = (await client.poses(12))[-1]
    one, two, three, four = (frame.of(channel) for channel in (1, 2, 3, 4))
    joints, examples = len(full["joints"]), len(three.weights)
    sizes = [opened["record_bytes"] for opened in (full, packed, weights, some)]
    assert sizes == [36 + 16 * joints, 36 + 6 * joints + joints % 2 * 2, 28 + 4 * examples, 36 + 18 + 2]
    assert sizes[1] <= 0.45 * sizes[0]
    np.testing.assert_array_equal(one.root, two.root)
    assert angle(one.rotations, two.rotations) < 1e-4
    assert three.weights.sum() == pytest.approx(1, abs=1e-5)
    assert some["joints"] == names
    expected = await ask(server, "reach", adverbs=REACH, phase=0.4, space="global", joints=names)
    assert angle(four.rotations, np.array(expected["rotations"])) < 1e-4


CHANGE = {
    "unity": np.diag([-1.0, 1.0, 1.0]),
    "unreal": np.array([[0.0, 0, 1], [-1, 0, 0], [0, 1, 0]]),
    "zup": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}


@pytest.mark.parametrize("frame", CHANGE)
async def test_frames_are_what_matrices_say(server, frame):
    async with open_stream(server) as client:
        fields = {"adverbs": REACH, "phase": 0.4, "play": False, "space": "global"}
        plain = await client.open(1, "reach", **fields)
        turned = await client.open(2, "reach", frame=frame, **fields)
        both = (await client.poses(6))[-1]
    matrix, unit = CHANGE[frame], 100.0 if frame == "unreal" else 1.0
    a, b = both.of(1), both.of(2)
    np.testing.assert_allclose(b.root, unit * matrix @ a.root, rtol=1e-5)
    np.testing.assert_allclose(
        np.array(turned["skeleton"]["offsets"]), unit * np.array(plain["skeleton"]["offsets"]) @ matrix.T, atol=1e-9
    )
    # A rotation in the other frame does to a vector there what the first does here.
    np.testing.assert_allclose(quat.to_matrix(b.rotations), matrix @ quat.to_matrix(a.rotations) @ matrix.T, atol=2e-6)


async def test_a_ping_tells_the_clock(server):
    async with open_stream(server) as client:
        await client.send("ping", t=12.5)
        pong = await client.until("pong")
        await client.open(1, "arm3")
        (frame,) = await client.poses(1)
    assert pong["t"] == 12.5
    assert 0 <= frame.time_ns - pong["server_time_ns"] < 1e9


@pytest.mark.parametrize(
    ("content", "code", "channel"),
    [
        ("no json", "bad_message", None),
        ("[]", "bad_message", None),
        ('{"op": "dance"}', "bad_message", None),
        ('{"op": "open", "channel": 5}', "bad_message", 5),
        ('{"op": "open", "channel": -1, "verb": "arm3"}', "bad_message", None),
        ('{"op": "open", "channel": 5, "verb": "arm3", "fps": 121}', "bad_message", 5),
        ('{"op": "open", "channel": 5, "verb": "arm3", "fps": 29.5}', "bad_message", 5),
        ('{"op": "open", "channel": 5, "verb": "arm3", "colour": 1}', "bad_message", 5),
        ('{"op": "open", "channel": 5, "verb": "arm3", "adverbs": {"x": NaN, "y": 0}}', "bad_message", None),
        ('{"op": "open", "channel": 5, "verb": "arm3", "adverbs": {"x": "1", "y": 0}}', "bad_message", 5),
        ('{"op": "open", "channel": 5, "verb": "unknown"}', "unknown_verb", 5),
        ('{"op": "open", "channel": 5, "verb": "arm3", "method": "magic"}', "unknown_method", 5),
        ('{"op": "open", "channel": 5, "verb": "arm3", "joints": ["Tail"]}', "unknown_joint", 5),
        ('{"op": "open", "channel": 5, "verb": "arm3", "adverbs": {"x": 1, "q": 0}}', "unknown_adverb", 5),
        ('{"op": "open", "channel": 5, "verb": "arm3", "adverbs": {"x": 1}}', "bad_request", 5),
        ('{"op": "open", "channel": 5, "verb": "arm3", "adverbs": {"x": 1e12, "y": 0}}', "out_of_range", 5),
        ('{"op": "open", "channel": 1, "verb": "arm3"}', "channel_in_use", 1),
        ('{"op": "set", "channel": 6}', "unknown_channel", 6),
        ('{"op": "set", "channel": 1, "adverbs": {"q": 0}}', "unknown_adverb", 1),
        ('{"op": "set", "channel": 1, "speed": 11}', "bad_message", 1),
        ('{"op": "switch", "channel": 1, "verb": "reach"}', "skeleton_mismatch", 1),
        ('{"op": "switch", "channel": 1, "verb": "arm3", "transition_s": -1}', "bad_message", 1),
        ('{"op": "close", "channel": 6}', "unknown_channel", 6),
        ('{"op": "ping"}', "bad_message", None),
        ('{"op": "resume", "session": "unknown", "last_seq": 0}', "unknown_session", None),
        (b"", "bad_message", None),
        (b"\x12\0\1\0" + bytes(8), "bad_message", None),
        (b"\x11\0\0\0", "bad_message", None),
        (b"\x11\0\2\0" + bytes(12), "bad_message", None),
        (b"\x11\0\1\0" + bytes(12), "unknown_channel", 0),
        (struct.pack("<BBHHHf", 0x11, 0, 1, 1, 0, 0), "out_of_range", 1),
        (struct.pack("<BBHHH2fHH2f", 0x11, 0, 2, 1, 0, 0, 0, 1, 0, 0, math.inf), "out_of_range", 1),
        (b"\x10\0\1\0" + bytes(7), "bad_message", None),
        (b"\x10\0\1\0" + bytes(12), "out_of_range", 1),
        (struct.pack("<BBH2f", 0x10, 0, 6, 0, 0), "unknown_channel", 6),
        (struct.pack("<BBH2f", 0x10, 0, 1, math.nan, 0), "out_of_range", 1),
        (struct.pack("<BBH2I", 0x10, 0, 1, 0x7F800001, 0), "out_of_range", 1),  # a signalling NaN
    ],
)
async def test_a_mistake_is_named_and_changes_nothing(server, content, code, channel):
    async with open_stream(server) as client:
        await client.open(1, "arm3", adverbs=ARM)
        await client.socket.send(content)
        error = await client.until("error")
        assert (error["code"], error["channel"]) == (code, channel)
        assert error["detail"]
        assert (await client.poses(2))[-1].of(1)


async def test_a_message_over_64_kib_ends_the_connection(server):
    async with open_stream(server) as client:
        await client.socket.send("x" * 70_000)
        with pytest.raises(ConnectionClosed) as closed:
            await client.until("never")
        assert closed.value.rcvd.code == 1009


async def test_limits_are_kept(serve):
    with serve(stream_channels=2, stream_characters=3, streams=2) as server:
        async with open_stream(server) as one, open_stream(server) as two:
            await one.open(1, "arm3")
            await one.open(2, "arm3")
            await one.send("open", channel=3, verb="arm3")
            assert (await one.until("error"))["code"] == "too_many_channels"
            await two.open(1, "arm3")
            await two.send("open", channel=2, verb="arm3")
            assert (await two.until("error"))["code"] == "too_many_channels"
            async with connect(server.url) as third:
                with pytest.raises(ConnectionClosed) as closed:
                    await asyncio.wait_for(third.recv(), 5)
                assert closed.value.rcvd.code == 4029
            await one.send("close", channel=1)
            await one.open(3, "arm3")


async def test_closed_channels_leave_nothing_behind(server):
    await eventually(lambda: not server.hub.sessions)
    async with open_stream(server) as client:
        for number in range(5):
            await client.open(number, "reach")
        await client.poses(2)
        for number in range(5):
            await client.send("close", channel=number)
        await client.send("ping", t=0)
        await client.until("pong")
        assert server.hub.characters == 0
        client.frames.clear()
        await client.for_seconds(0.1)
        assert not client.frames
    await eventually(lambda: not server.hub.sessions)
    assert all(len(group.characters) == 0 for group in server.hub.channels.groups.values())


async def test_metrics_tell_of_streams(server):
    async with open_stream(server) as client:
        await client.open(1, "reach")
        await client.open(2, "reach")
        await client.for_seconds(0.8)
        async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{server.port}") as http:
            text = (await http.get("/metrics")).text
    lines = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    assert float(lines["adverb_streams"]) == 1
    assert float(lines["adverb_channels"]) == 2
    assert float(lines["adverb_stream_frames_total"]) > 20
    assert float(lines["adverb_stream_frames_dropped_total"]) >= 0
    assert float(lines["adverb_stream_lateness_seconds_count"]) > 20
    assert float(lines['adverb_poses_total{method="corrected",verb="reach"}']) > 40
