"""Records of REST responses as arrays."""

import numpy as np

from service import wire


def records_of(content: bytes, joints: int):
    """f32 records as a read-only structured array; raises ValueError if the length does not fit."""
    return np.frombuffer(content, wire.record(joints))
