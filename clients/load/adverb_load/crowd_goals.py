"""Goals of a crowd as ready-made bytes, and errors of the poses that follow them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from adverb_client.records import ENCODINGS, Q32, Q48, decode_q32, decode_q48, record_dtype
from adverb_client.wire import encode_adverbs, encode_bulk_adverbs

from adverb_load import frames
from adverb_load.effector import Effector
from adverb_load.goals import Goals

__all__ = ["STRIDE", "Steering", "errors_of"]

STRIDE = 37
"""Steps of the walk between two channels of a socket."""

NO_MASK = bytes(4)
"""A mask of zeros: the payload is sent as it is, so that frames are built once."""

RECENT = 256
"""Number of the last goals with which a pose is compared; two of them are millimetres to centimetres apart."""


@dataclass(frozen=True, slots=True)
class Steering:
    """Frames that set the goals of all channels of a socket, one for each step of a walk; sockets share them.

    Parameters
    ----------
    goals : Goals
    frames : list of bytes
    """

    goals: Goals
    frames: list[bytes]

    @classmethod
    def of(cls, goals: Goals, channels: int, *, bulk: bool) -> Steering:
        """Frames of one message 0x11, or of one message 0x10 for each channel."""
        numbers = np.arange(channels)
        made = []
        for step in range(len(goals.rows)):
            rows = goals.rows[(step + STRIDE * numbers) % len(goals.rows)]
            if bulk:
                messages = encode_bulk_adverbs(numbers, rows)
            else:
                messages = [encode_adverbs(number, row) for number, row in zip(numbers.tolist(), rows, strict=True)]
            made.append(b"".join(frames.frame(frames.BINARY, message, NO_MASK) for message in messages))
        return cls(goals, made)

    def goal(self, channel: int, step: int) -> npt.NDArray[np.float32]:
        """The goal (D,) of a channel at a step."""
        row: npt.NDArray[np.float32] = self.goals.rows[(step + STRIDE * channel) % len(self.goals.rows)]
        return row


def errors_of(
    records: npt.NDArray[np.uint8], steps: npt.NDArray[np.int64], channel: int, goals: Goals, effector: Effector,
    encoding: str, *, moving: bool,
) -> npt.NDArray[np.float64]:  # fmt: skip
    """Distance between the effector, by forward kinematics, and the goal that was sent.

    Parameters
    ----------
    records : (K, bytes) uint8
        Records of one channel of several sockets, which shows the effector at its keytime.
    steps : (K,) int64
        Step of the goals that had been sent when each record arrived.
    channel : int
    goals : Goals
    effector : Effector
    encoding : str
    moving : bool
        Whether goals change: the record then has one of the last goals, and the nearest counts.

    Returns
    -------
    (K,) float64
        Metres.
    """
    number = ENCODINGS[encoding]
    rows = records.reshape(-1).view(record_dtype(number, effector.joints))
    if number == Q48:
        rotations = decode_q48(rows["words"])
    elif number == Q32:
        rotations = decode_q32(rows["words"])
    else:
        rotations = rows["rotations"]
    points = effector.points(rows["root"].astype(np.float64), rotations.astype(np.float64))
    recent = np.arange(RECENT if moving else 1)
    indices = (steps[:, None] - recent + STRIDE * channel) % len(goals.rows)
    distances = np.linalg.norm(points[:, None] - goals.rows[indices].astype(np.float64), axis=-1)
    nearest: npt.NDArray[np.float64] = distances.min(axis=1)
    return nearest
