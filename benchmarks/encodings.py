"""``make bench-encodings``: error of the pose encodings, as game engines measure it.

Three virtual points stand 3 cm from every joint, along its local axes. They are compared in object space between the
exact pose and the decoded one, so that errors of all joints above add up. Encoding follows ``docs/wire.md``; decoding
is that of the Python client. Verbs are those of motion capture, built-in ones where there is none.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from adverb_client.records import ENCODINGS, decode_q32, decode_q48, record_dtype

from benchmarks.streams import NoCapture, capture
from verbs import Evaluator, library
from verbs.authoring.fit import build
from verbs.domain import random_points
from verbs.errors import VerbError
from verbs.kernels import quat
from verbs.runtime.evaluate import Poses
from verbs.skeleton import Skeleton
from verbs.verb import Verb

Numbers = npt.NDArray[np.float64]

VERBS = ("reach", "punch", "kick", "locomotion")
POINT_M = 0.03
"""Distance of a virtual point from its joint."""

PERCENTILES = (50, 99, 100)


def smallest_three(rotations: Numbers, steps: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Stored steps (..., 3), 0 … 2·steps, and the index of the omitted component (...) of unit quaternions (..., 4)."""
    omitted = np.argmax(np.abs(rotations), axis=-1)
    largest = np.take_along_axis(rotations, omitted[..., None], -1)
    kept = np.arange(3) + (np.arange(3) >= omitted[..., None])
    parts = np.take_along_axis(np.where(largest < 0.0, -rotations, rotations), kept, -1)
    stored = np.clip(np.floor(steps * math.sqrt(2.0) * parts + 0.5), -steps, steps)
    return stored.astype(np.int64) + steps, omitted


def encode_q48(rotations: Numbers) -> npt.NDArray[np.uint16]:
    """Words (..., 3) of unit quaternions (..., 4)."""
    words, omitted = smallest_three(rotations, 16_383)
    words[..., 0] |= (omitted & 1) << 15
    words[..., 1] |= (omitted >> 1) << 15
    return words.astype(np.uint16)


def encode_q32(rotations: Numbers) -> npt.NDArray[np.uint32]:
    """Words (...) of unit quaternions (..., 4)."""
    words, omitted = smallest_three(rotations, 511)
    packed = words[..., 0] | words[..., 1] << 10 | words[..., 2] << 20 | omitted << 30
    return packed.astype(np.uint32)


DECODED: dict[str, Callable[[Numbers], Numbers]] = {
    "f32": lambda rotations: rotations.astype(np.float32).astype(np.float64),
    "q48": lambda rotations: decode_q48(encode_q48(rotations)).astype(np.float64),
    "q32": lambda rotations: decode_q32(encode_q32(rotations)).astype(np.float64),
}
"""Rotations (..., 4) after encoding and decoding, by encoding."""


def virtual_points(rotations: Numbers, skeleton: Skeleton) -> Numbers:
    """Points (B, J, 3, 3) at :data:`POINT_M` from every joint along its x, y and z, in object space, metres.

    Parameters
    ----------
    rotations : (B, J, 4)
        Local rotations. The root's position, f32 in all encodings, is left out.
    skeleton : Skeleton
    """
    size, joints = rotations.shape[:2]
    global_, positions = np.empty((size, joints, 4)), np.zeros((size, joints, 3))
    for joint, parent in enumerate(skeleton.parents):
        own = rotations[:, joint]
        global_[:, joint] = own if parent < 0 else quat.mul(global_[:, parent], own)
        if parent >= 0:
            arm = quat.rotate(global_[:, parent], skeleton.offsets[joint])
            positions[:, joint] = positions[:, parent] + arm
    points: Numbers = positions[:, :, None] + quat.rotate(global_[:, :, None], POINT_M * np.eye(3))
    return points


def errors_mm(found: Numbers, exact: Numbers, skeleton: Skeleton) -> Numbers:
    """Distances (B·J·3,) between virtual points of local rotations (B, J, 4), millimetres."""
    apart = virtual_points(found, skeleton) - virtual_points(exact, skeleton)
    return np.asarray(1e3 * np.linalg.norm(apart, axis=-1)).ravel()


def record_bytes(encoding: str, joints: int, examples: int) -> int:
    """Length of a record in a stream, padding included."""
    size = record_dtype(ENCODINGS[encoding], examples if encoding == "weights" else joints).itemsize
    return size + -size % 4


def poses_of(evaluator: Evaluator, count: int, seed: int = 1) -> Poses:
    """Poses at random goals inside the hull of the examples and at random phases."""
    rng = np.random.default_rng(seed)
    goals = random_points(evaluator.verb, rng, count)
    return evaluator.pose(goals, phase=rng.uniform(0.0, 1.0, count))


def rows_of(verb: Verb, count: int) -> Iterator[tuple[str, int, list[float]]]:
    """Encoding, bytes of a record, and percentiles of the error in mm."""
    evaluator = Evaluator(verb)
    poses = poses_of(evaluator, count)
    decoded = {name: decode(poses.rotations) for name, decode in DECODED.items()}
    rounded = replace(poses.blend, weights=poses.blend.weights.astype(np.float32).astype(np.float64))
    decoded["weights"] = evaluator.pose_of(rounded, phase=poses.phase).rotations
    for name, rotations in decoded.items():
        errors = errors_mm(rotations, poses.rotations, verb.skeleton)
        size = record_bytes(name, len(verb.skeleton), len(verb.examples))
        yield name, size, np.percentile(errors, PERCENTILES).tolist()


def verb_of(name: str) -> tuple[Verb, str]:
    """A verb and where its motions are from; raises :class:`VerbError` if there is neither capture nor a built-in."""
    try:
        folder = capture().parent / name
    except NoCapture:
        folder = Path()
    if (folder / "verb.toml").is_file():
        return build(folder).verb, "captured"
    return library.load(name), "built-in"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table in Markdown; 2 without any verb."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.encodings", description=__doc__)
    parser.add_argument("--poses", type=int, default=20_000, help="poses of each verb (%(default)s)")
    chosen = parser.parse_args(arguments)
    print(f"| verb | encoding | bytes | p50, mm | p99, mm | max, mm |\n| --- | --- | {' | '.join(['---:'] * 4)} |")
    printed = False
    for name in VERBS:
        try:
            verb, source = verb_of(name)
        except VerbError as err:
            print(f"{name}: left out: {err}", file=sys.stderr)
            continue
        for encoding, size, errors in rows_of(verb, chosen.poses):
            head = f"{name}, {source}" if encoding == "f32" else ""
            print(f"| {head} | `{encoding}` | {size} | {' | '.join(f'{error:.2g}' for error in errors)} |", flush=True)
            printed = True
    return 0 if printed else 2


if __name__ == "__main__":
    sys.exit(main())
