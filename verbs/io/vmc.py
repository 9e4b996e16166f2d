"""Poses as packets of the Virtual Motion Capture protocol (VMC), which Unity, Unreal, Godot and VRM programs receive.

A packet is an OSC bundle: addresses, type tags and names once, then numbers. Everything but the numbers is the same in
each frame, so packets are built once and the numbers are written into them.

Bones have the names of Unity's ``HumanBodyBones``. Coordinates are Unity's: left-handed, +Y up, +Z forward, metres.
Rotations are local to the bone above and relative to the T-pose (:func:`verbs.io.humanoid.t_pose`).

Sources: Virtual Motion Capture Protocol 2.7 (protocol.vmc.info); OSC 1.0 (opensoundcontrol.org).
"""

from __future__ import annotations

import socket
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64
from verbs.errors import OutOfRange, RequestError
from verbs.io.humanoid import bones_above, bones_of, missing, t_pose
from verbs.kernels import pose, quat
from verbs.skeleton import Skeleton

__all__ = ["PORT", "VmcPackets", "address_of", "unity_name"]

PORT = 39539
"""Port on which performers are received by default."""

MAX_BYTES = 1_472
"""Largest packet: 1,500 bytes with the headers of IP and UDP, beyond which networks split or drop it."""

_AT_ONCE = struct.pack(">Q", 1)
"""Time tag of a bundle whose messages count at once."""

_STILL = np.array([0.0, 0.0, 0.0, 1.0])

_THUMBS = {"ThumbMetacarpal": "ThumbProximal", "ThumbProximal": "ThumbIntermediate"}
"""Bones that VRM 1.0 and Unity name differently."""


def unity_name(bone: str) -> str:
    """Name of a VRM bone in Unity's ``HumanBodyBones``."""
    for ours, theirs in _THUMBS.items():
        if bone.endswith(ours):
            bone = bone.removesuffix(ours) + theirs
            break
    return bone[0].upper() + bone[1:]


def address_of(text: str) -> tuple[socket.AddressFamily, Any]:
    """Family and address of ``HOST:PORT``; raises :class:`OutOfRange` or :class:`RequestError`."""
    host, found, port = text.rpartition(":") if not text.endswith("]") else (text, "", "")
    if not found:
        host, port = text, str(PORT)
    if not port.isdigit() or not 1 <= int(port) <= 65_535 or not host:
        raise OutOfRange(f"'{text:.100}' is no address; write HOST:PORT, e.g. 127.0.0.1:{PORT}")
    try:
        row = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)[0]
    except OSError as problem:
        raise RequestError(f"the host '{host:.100}' is not known: {problem.strerror or problem}") from problem
    return row[0], row[4]


@dataclass(frozen=True, slots=True)
class _Packet:
    """One packet: its bytes, the same as big-endian floats, and where its numbers are.

    ``rows`` (n,) are rows of the table of values, ``at`` (n, 7) the places of their numbers; ``clock`` is the place of
    the time.
    """

    content: bytearray
    floats: npt.NDArray[np.float32]
    rows: npt.NDArray[np.intp]
    at: npt.NDArray[np.intp]
    clock: int


class VmcPackets:
    """Packets of one skeleton.

    Parameters
    ----------
    skeleton : Skeleton
        Its joints are named as in :data:`verbs.io.humanoid.BONES`.

    Attributes
    ----------
    bones : tuple of str
        Names of the bones that are sent, parents first.

    Raises
    ------
    RequestError
        The skeleton lacks a bone that a humanoid must have, or its hips are not the root.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        bones = bones_of(skeleton)
        if lacking := missing(bones):
            raise RequestError(f"the skeleton is no humanoid: it has no joint for {', '.join(lacking)}")
        if bones["hips"] != 0:
            raise RequestError(f"the hips of a humanoid are its root, which is '{skeleton.names[0]:.60}' here")
        order = sorted(bones.items(), key=lambda row: row[1])
        self._skeleton = skeleton
        self._joints = np.array([joint for _, joint in order])
        self._above = np.array(bones_above(skeleton.parents.tolist(), self._joints.tolist()))
        self._back = quat.conjugate(t_pose(skeleton, bones)[self._joints])
        self.bones = tuple(unity_name(bone) for bone, _ in order)
        self._values = np.zeros((1 + len(order), 7))
        self._values[0, 6] = 1.0  # the root of the stage: the hips have the character's place
        self._packets = _packets(self.bones)

    def pack(self, root: F64, rotations: F64, time_s: float) -> list[bytearray]:
        """Packets of one pose; the next call writes into the same ones.

        Parameters
        ----------
        root : (3,) float64
            Position of the root joint, metres.
        rotations : (J, 4) float64
            Local rotations.
        time_s : float
            Time of the pose, seconds.
        """
        skeleton = self._skeleton
        turns, places = np.empty((1, *rotations.shape)), np.empty((1, len(rotations), 3))
        pose.forward(root[None], rotations[None], skeleton.parents, skeleton.offsets, turns, places)
        turned, place = quat.mul(turns[0, self._joints], self._back), places[0, self._joints]
        above, below = self._above[1:], slice(1, None)
        back = quat.conjugate(turned[above])
        values = self._values[1:]
        values[0, :3], values[0, 3:] = place[0], turned[0]
        values[below, :3] = quat.rotate(back, place[below] - place[above])
        values[below, 3:] = quat.mul(back, turned[below])
        values *= _UNITY
        for packet in self._packets:
            packet.floats[packet.at] = self._values[packet.rows]
            packet.floats[packet.clock] = time_s
        return [packet.content for packet in self._packets]


_UNITY = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0])
"""Signs of position and rotation where the x axis points the other way."""


def _text(value: str) -> bytes:
    """A text of OSC: ASCII, ended by a zero, padded to a multiple of 4 bytes."""
    content = value.encode("ascii")
    return content + bytes(4 - len(content) % 4)


def _element(address: str, tags: str, *arguments: bytes) -> bytes:
    """A message as an element of a bundle: its size, address, type tags and arguments."""
    message = _text(address) + _text(f",{tags}") + b"".join(arguments)
    return struct.pack(">i", len(message)) + message


def _packets(bones: tuple[str, ...]) -> list[_Packet]:
    """Packets that hold all bones; each begins with the state of the performer and the time."""
    state = _element("/VMC/Ext/OK", "iiii", struct.pack(">4i", 1, 3, 0, 1))  # loaded, calibrated, normal, tracked
    clock = _element("/VMC/Ext/T", "f", bytes(4))
    head = _text("#bundle") + _AT_ONCE + state + clock
    rows = [_element("/VMC/Ext/Root/Pos", "sfffffff", _text("root"), bytes(28))]
    rows += [_element("/VMC/Ext/Bone/Pos", "sfffffff", _text(bone), bytes(28)) for bone in bones]
    found, first = [], 0
    while first < len(rows):
        content, at, last = bytearray(head), [], first
        while last < len(rows) and len(content) + len(rows[last]) <= MAX_BYTES:
            content += rows[last]
            at.append(len(content) // 4 - 7 + np.arange(7))
            last += 1
        floats = np.frombuffer(content, ">f4")
        found.append(_Packet(content, floats, np.arange(first, last), np.array(at), len(head) // 4 - 1))
        first = last
    return found
