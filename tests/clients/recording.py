"""The recorded stream that clients in all languages replay."""

from __future__ import annotations

from typing import Any

import numpy as np

from tools import golden_stream


def check(found: list[dict[str, Any]], expected: dict[str, Any]) -> None:
    """Compare joint positions of all records: ``[{sequence, records: [{channel, version, positions}]}]``."""
    assert [message["sequence"] for message in found] == [message["sequence"] for message in expected["messages"]]
    for message, reference in zip(found, expected["messages"], strict=True):
        for row, record in zip(message["records"], reference["records"], strict=True):
            assert (row["channel"], row["version"]) == (record["channel"], record["version"])
            difference = np.subtract(row["positions"], record["positions"]).reshape(-1, 3)
            assert np.linalg.norm(difference, axis=1).max() <= expected["tolerance_m"], record["encoding"]


ARGUMENTS = [str(golden_stream.STREAM), str(golden_stream.EXPECTED), str(golden_stream.ROOT)]
"""Of programs: the recording, its positions with the artifacts, the folder of their paths."""
