"""Units, axes and orders that all modules follow, and limits of sizes.

- Right-handed; +Y up, +Z forward, +X to the left of who faces +Z. This is glTF's convention.
- Metres, seconds, radians. Files are converted in :mod:`verbs.io`; adverbs keep their unit (:mod:`verbs.units`).
- Quaternions are (x, y, z, w), unit, local to the parent unless a name contains ``global``.
- Parents stand before their children; the root is joint 0 and its parent is -1.
- Batch axes lead: rotations are (..., joints, 4), positions (..., joints, 3).
"""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Floats = npt.NDArray[np.floating[Any]]
F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

MAX_JOINTS = 1_000
MAX_FRAMES = 200_000
MAX_FILE_BYTES = 256 * 1024 * 1024
MAX_EXAMPLES = 2_000
MAX_ADVERBS = 16
MAX_KEYTIMES = 64
MAX_KEYS = 8_192
"""Canonical samples of one verb: 8,192 keys are 2 minutes at 60 Hz."""

MAX_MAGNITUDE = 1e9
"""Largest magnitude of an adverb, a keytime, and any other number of a source or a request."""

METRES_PER_UNIT = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}


def freeze(instance: DataclassInstance) -> None:
    """Make every array field of a frozen dataclass a read-only, C-contiguous view.

    Built arrays and arrays mapped from a file then have the same Numba type. Kernels are compiled per type, and two
    compilations may differ in the last bit: one type gives the same bits for both, and one compilation.
    """
    for entry in fields(instance):
        value = getattr(instance, entry.name, None)  # a field that is set afterwards has none yet
        if isinstance(value, np.ndarray):
            view = np.ascontiguousarray(value).view()
            view.flags.writeable = False
            object.__setattr__(instance, entry.name, view)
