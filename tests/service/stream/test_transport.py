"""The fast path past ASGI: frames follow RFC 6455, and messages keep their order."""

import asyncio
import socket
import threading
import time

import pytest
import uvicorn
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from service.stream.transport import MAX_DIRECT, TRANSPORT, UNSENT_BYTES, StreamProtocol
from tests.service.stream.conftest import PATIENCE_S, eventually, open_stream

pytestmark = pytest.mark.anyio

LENGTHS = [0, 1, 125, 126, UNSENT_BYTES + 1, 65_535, 65_536, 300_000]
REACH = {"x": -0.3, "y": 1.2, "z": 0.45}


class Posting:
    """An app that sends a message of each length, each on a signal."""

    def __init__(self):
        self.sockets, self.over = [], threading.Event()

    async def __call__(self, scope, receive, send):
        if scope["type"] != "websocket":
            return
        await receive()
        await send({"type": "websocket.accept"})
        short = scope["extensions"][TRANSPORT]
        self.sockets.append(short)
        for length in LENGTHS:
            while not short.send_binary(bytes(k % 251 for k in range(length))):
                await short.writable.wait()
        while (await receive())["type"] != "websocket.disconnect":
            pass
        with pytest.raises(ConnectionError):
            short.send_binary(b"late")
        self.over.set()


@pytest.fixture
def posting():
    app = Posting()
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        config = uvicorn.Config(app, ws=StreamProtocol, ws_per_message_deflate=False, lifespan="off", log_level="error")
        server = uvicorn.Server(config)
        thread = threading.Thread(target=lambda: server.run(sockets=[listener]))
        thread.start()
        end = time.monotonic() + PATIENCE_S
        while not server.started and time.monotonic() < end:
            time.sleep(0.01)
        app.url = f"ws://127.0.0.1:{listener.getsockname()[1]}/"
        yield app
        server.should_exit = True
        thread.join(PATIENCE_S)


async def test_messages_of_every_length_arrive_whole_and_in_order(posting):
    async with connect(posting.url, max_size=None, compression=None) as client:
        for length in LENGTHS:
            assert await asyncio.wait_for(client.recv(), PATIENCE_S) == bytes(k % 251 for k in range(length))
    assert posting.over.wait(PATIENCE_S)


async def test_adverbs_that_follow_an_open_are_those_of_the_character_it_opened(server):
    async with open_stream(server) as client:
        await client.send("open", channel=2, verb="reach", adverbs=REACH, fps=1)
        await client.set_adverbs(2, -0.2, 1.1, 0.4)
        await client.send("close", channel=2)
        await client.send("open", channel=2, verb="arm3", fps=1)
        await client.set_adverbs(2, 0.5, 0.1)
        await client.send("ping", t=1)
        await client.until("pong")
        assert [text["op"] for text in client.texts if text["op"] == "error"] == []
        channel = server.hub.sessions[client.hello["session"]].channels[2]
        assert channel.group.characters.goals[channel.slot].tolist() == pytest.approx([0.5, 0.1])


async def test_a_flood_of_adverbs_is_heard_to_its_end(server):
    async with open_stream(server) as client:
        await client.open(0, "arm3", fps=1)
        channel = server.hub.sessions[client.hello["session"]].channels[0]
        for k in range(20 * MAX_DIRECT):
            await client.set_adverbs(0, 0.3 + 0.0001 * k, 0.2)
        last = pytest.approx([0.3 + 0.0001 * (20 * MAX_DIRECT - 1), 0.2])
        await eventually(lambda: channel.group.characters.goals[channel.slot].tolist() == last)


async def test_wrong_binary_messages_are_told_in_order(server):
    async with open_stream(server) as client:
        await client.set_adverbs(7, 1.0)
        await client.socket.send(b"\x10")
        await client.socket.send(b"")
        await client.send("ping", t=1)
        await client.until("pong")
        codes = [text["code"] for text in client.texts if text["op"] == "error"]
        assert codes == ["unknown_channel", "bad_message", "bad_message"]


@pytest.mark.parametrize("pieces", [b"\xff", [b'{"op": "ping", "t"', b": 1\xc3", b"}"]], ids=["whole", "in pieces"])
async def test_text_that_is_not_utf8_ends_its_connection_and_no_other(server, pieces, caplog):
    async with open_stream(server) as other, open_stream(server) as client:
        await client.socket.send(pieces, text=True)
        with pytest.raises(ConnectionClosed) as closed:
            await client.until("never")
        assert closed.value.rcvd.code == 1007
        await other.send("ping", t=1)
        await other.until("pong")
    assert not [record for record in caplog.records if record.exc_info]
