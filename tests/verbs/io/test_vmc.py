"""VMC packets, read by another implementation of OSC: bones, places, the T-pose, and a real receiver."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle
from typer.testing import CliRunner

from verbs import library
from verbs.cli.application import app
from verbs.errors import OutOfRange, RequestError
from verbs.io import humanoid, vmc
from verbs.kernels import fk, quat
from verbs.runtime.characters import Characters
from verbs.runtime.evaluate import Evaluator

HUMANOIDS = ("reach", "locomotion", "jump", "board")

ABOVE = {
    "Spine": "Hips", "Chest": "Spine", "UpperChest": "Chest", "Neck": "UpperChest", "Head": "Neck",
    **{f"{s}Shoulder": "UpperChest" for s in ("Left", "Right")},
    **{f"{s}UpperArm": f"{s}Shoulder" for s in ("Left", "Right")},
    **{f"{s}LowerArm": f"{s}UpperArm" for s in ("Left", "Right")},
    **{f"{s}Hand": f"{s}LowerArm" for s in ("Left", "Right")},
    **{f"{s}UpperLeg": "Hips" for s in ("Left", "Right")},
    **{f"{s}LowerLeg": f"{s}UpperLeg" for s in ("Left", "Right")},
    **{f"{s}Foot": f"{s}LowerLeg" for s in ("Left", "Right")},
    **{f"{s}Toes": f"{s}Foot" for s in ("Left", "Right")},
    **{
        f"{s}{finger}{part}": f"{s}Hand" if above is None else f"{s}{finger}{above}"
        for s in ("Left", "Right")
        for finger in ("Thumb", "Index", "Middle", "Ring", "Little")
        for part, above in (("Proximal", None), ("Intermediate", "Proximal"), ("Distal", "Intermediate"))
    },
}  # fmt: skip
"""Bone above each bone, as Unity has them."""


def messages(packet: bytes):
    """Address and arguments of the messages of a packet."""
    assert len(packet) <= 1_472
    assert OscBundle.dgram_is_bundle(bytes(packet))
    return [(one.address, list(one.params)) for one in OscBundle(bytes(packet))]


def received(packets):
    """Position and rotation of each bone, in the order of arrival."""
    rows = [params for packet in packets for address, params in messages(packet) if address == "/VMC/Ext/Bone/Pos"]
    return {name: (np.array(numbers[:3]), np.array(numbers[3:])) for name, *numbers in rows}


def places(bones):
    """Global positions of bones; the bone above a missing one takes its place."""
    turns, found = {}, {}
    for name, (place, turn) in bones.items():
        above = ABOVE.get(name)
        while above is not None and above not in bones:
            above = ABOVE.get(above)
        if above is None:
            turns[name], found[name] = turn, place
        else:
            turns[name] = quat.mul(turns[above], turn)
            found[name] = found[above] + quat.rotate(turns[above], place)
    return found


@pytest.mark.parametrize("name", HUMANOIDS)
def test_a_receiver_finds_every_joint(name):
    verb = library.load(name)
    characters = Characters(Evaluator(verb))
    slots = np.array([characters.add(loop) for loop in (None,)])
    characters.set(int(slots[0]), looping=True)
    packets = vmc.VmcPackets(verb.skeleton)
    joints = {vmc.unity_name(bone): joint for bone, joint in humanoid.bones_of(verb.skeleton).items()}
    for _ in range(20):
        frames = characters.step(slots, 0.1)
        root, rotations = frames.root[0], frames.rotations[0]
        expected = fk.forward(root[None], rotations[None], verb.skeleton.parents, verb.skeleton.offsets)[1][0]
        found = places(received(packets.pack(root, rotations, 0.0)))
        assert found.keys() == joints.keys()
        for bone, joint in joints.items():
            np.testing.assert_allclose(found[bone] * [-1, 1, 1], expected[joint], atol=1e-5)


def test_the_t_pose_has_no_rotations_and_arms_along_the_x_axis():
    skeleton = library.load("reach").skeleton
    packets = vmc.VmcPackets(skeleton)
    turned = humanoid.t_pose(skeleton, humanoid.bones_of(skeleton))
    local = turned.copy()
    local[1:] = quat.mul(quat.conjugate(turned[skeleton.parents[1:]]), turned[1:])
    bones = received(packets.pack(np.array([0.0, 1.0, 0.0]), local, 0.0))
    for _, turn in bones.values():
        np.testing.assert_allclose(np.abs(turn), [0, 0, 0, 1], atol=1e-6)
    found = places(bones)
    assert found["RightHand"][0] > 0.4 > -0.4 > found["LeftHand"][0]  # +X is right in Unity
    np.testing.assert_allclose(found["LeftHand"][1:], found["LeftUpperArm"][1:], atol=1e-5)
    assert found["LeftFoot"][1] < 0.3


def test_state_time_and_root_are_sent_and_thumbs_renamed():
    verb = library.load("reach")
    packets = vmc.VmcPackets(verb.skeleton)
    rest = np.tile([0.0, 0.0, 0.0, 1.0], (len(verb.skeleton), 1))
    sent = packets.pack(np.zeros(3), rest, 1.5)
    assert len(sent) > 1  # more than fits into one
    heads = [messages(packet)[:2] for packet in sent]
    assert heads == [[("/VMC/Ext/OK", [1, 3, 0, 1]), ("/VMC/Ext/T", [1.5])]] * len(sent)
    assert messages(sent[0])[2] == ("/VMC/Ext/Root/Pos", ["root", 0, 0, 0, 0, 0, 0, 1])
    assert vmc.unity_name("leftThumbMetacarpal") == "LeftThumbProximal"
    assert vmc.unity_name("leftThumbProximal") == "LeftThumbIntermediate"
    assert vmc.unity_name("rightIndexProximal") == "RightIndexProximal"


def test_a_skeleton_that_is_no_humanoid_is_refused():
    with pytest.raises(RequestError, match="no joint for hips"):
        vmc.VmcPackets(library.load("arm3").skeleton)


def test_the_command_sends_to_a_receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(30)
        to = f"127.0.0.1:{receiver.getsockname()[1]}"
        given = [
            "vmc",
            "--verb",
            "reach",
            "--at",
            "x=-0.3,y=1.2,z=0.4",
            "--to",
            to,
            "--seconds",
            "0.2",
            "--wander",
            "0.1",
        ]
        done = CliRunner().invoke(app, given)
        assert done.exit_code == 0, done.output
        size = len(vmc.VmcPackets(library.load("reach").skeleton)._packets)
        packets = [receiver.recv(2_000) for _ in range(12 * size)]
    times = [params[0] for packet in packets for address, params in messages(packet) if address == "/VMC/Ext/T"]
    np.testing.assert_allclose(times[::size], np.arange(12) / 60, atol=1e-6)
    first, last = received(packets[:size]), received(packets[-size:])
    assert max(float(np.abs(first[name][1] - last[name][1]).max()) for name in first) > 1e-3


@pytest.mark.parametrize("text", ["", "127.0.0.1:0", "127.0.0.1:x", "127.0.0.1:70000", ":39539"])
def test_wrong_addresses_are_named(text):
    with pytest.raises(OutOfRange, match="write HOST:PORT"):
        vmc.address_of(text)


def test_addresses_have_a_default_port():
    assert vmc.address_of("127.0.0.1")[1][:2] == ("127.0.0.1", vmc.PORT)
    assert vmc.address_of("[::1]:4000")[1][:2] == ("::1", 4000)
