"""Channels whose poses are sent to a receiver of VMC that the operator has named."""

import socket

import numpy as np
import pytest
from pydantic import ValidationError

from service.settings import Settings, receivers_of
from service.stream.vmc import MAX_SENDERS, Receivers
from tests.service.stream.conftest import open_stream
from tests.verbs.io.test_vmc import messages, places, received
from verbs import library
from verbs.errors import OutOfRange, RequestError, UnknownName
from verbs.io import humanoid, vmc
from verbs.kernels import fk

pytestmark = pytest.mark.anyio

TOLERANCE_M = 1e-4


@pytest.fixture
def receiver():
    """A receiver, and its place in the setting."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(30)
        yield opened, f"stage=127.0.0.1:{opened.getsockname()[1]}"


def pose_of(opened, bones):
    """Global positions of a whole pose, of packets with the same time."""
    found, time_s = {}, None
    while len(found) < bones:
        packet = opened.recv(2_000)
        now = next(params[0] for address, params in messages(packet) if address == "/VMC/Ext/T")
        found = received([packet]) if now != time_s else found | received([packet])
        time_s = now
    return places(found)


async def test_a_receiver_rebuilds_the_pose_of_the_channel(serve, receiver):
    opened, setting = receiver
    skeleton = library.load("reach").skeleton
    joints = {vmc.unity_name(bone): joint for bone, joint in humanoid.bones_of(skeleton).items()}
    with serve(vmc=setting) as server:
        async with open_stream(server) as client:
            await client.open(1, "reach", phase=0.3, play=False, vmc="stage", fps=30)
            await client.poses(5)
            record = client.frames[-1].of(1)
            found = pose_of(opened, len(joints))
            expected = fk.forward(
                record.root[None].astype(float),
                record.rotations[None].astype(float),
                skeleton.parents,
                skeleton.offsets,
            )[1][0]
            assert found.keys() == joints.keys()
            for bone, joint in joints.items():
                np.testing.assert_allclose(found[bone] * [-1, 1, 1], expected[joint], atol=TOLERANCE_M)
            await client.send("switch", channel=1, verb="punch")
            await client.until("opened", channel=1)
            await client.poses(5)
            assert len(pose_of(opened, len(joints))) == len(joints)
            await client.send("close", channel=1)
            await client.open(2, "reach", vmc="stage")
            assert server.state.hub.channels.receivers.senders == 1


async def test_a_character_at_rest_is_sent_all_the_same(serve, receiver):
    opened, setting = receiver
    with serve(vmc=setting) as server:
        async with open_stream(server) as client:
            await client.open(1, "reach", play=False, vmc="stage", encoding="weights", send="changes")
            for _ in range(40):
                opened.recv(2_000)


async def test_only_the_operators_receivers_can_be_chosen(serve, receiver):
    _, setting = receiver
    with serve(vmc=setting) as server:
        async with open_stream(server) as client:
            for name in ("10.0.0.1:9", "other", "stage=127.0.0.1:1"):
                await client.send("open", channel=1, verb="reach", vmc=name)
                error = await client.until("error")
                assert error["code"] == "bad_request"
                assert "stage" in error["detail"]
            await client.send("open", channel=1, verb="arm3", vmc="stage")
            assert "no humanoid" in (await client.until("error"))["detail"]
            await client.send("open", channel=1, verb="reach", vmc="stage", adverbs={"unknown": 1.0})
            assert (await client.until("error"))["code"] == "unknown_adverb"
            assert server.state.hub.channels.receivers.senders == 0


def test_a_server_has_a_limit():
    receivers = Receivers("a=127.0.0.1:9, b=[::1]:9")
    senders = [receivers.sender(name) for name, _ in zip("ab" * MAX_SENDERS, range(MAX_SENDERS), strict=False)]
    with pytest.raises(OutOfRange):
        receivers.sender("a")
    senders.pop().close()
    receivers.sender("b")
    with pytest.raises(UnknownName):
        receivers.sender("c")
    receivers.close()


@pytest.mark.parametrize("text", ["stage", "=1.2.3.4", "a=", "a=1:2,b"])
def test_a_receiver_needs_a_name_and_an_address(text):
    with pytest.raises(ValueError, match="NAME=HOST:PORT"):
        receivers_of(text)
    with pytest.raises(ValidationError):
        Settings(vmc=text)


def test_an_address_that_does_not_exist_is_an_error():
    with pytest.raises(RequestError, match="no address"):
        Receivers("a=127.0.0.1:99999")
