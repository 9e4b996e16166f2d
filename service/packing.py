"""Records of streams, written by compiled calls: of poses that exist, and of characters that are stepped.

The format is :mod:`service.wire`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from service.wire import (
    CLAMPED,
    DETERMINANT,
    F32_ENCODING,
    HEAD_WORDS,
    IN_TRANSITION,
    LAST,
    Q32_SCALE,
    Q48,
    Q48_SCALE,
    SIGN,
    SOURCE,
    U16,
    U32,
    UNITS,
    WEIGHTS,
    Flags,
    Layout,
    Targets,
)  # fmt: skip
from verbs import library
from verbs.conventions import F32, F64, I64
from verbs.kernels.character_state import PROGRESS, Records
from verbs.kernels.compile import direct, kernel
from verbs.kernels.crowd_pose import TILE, Curves, finish_single, share, sort_by_interval, sums
from verbs.kernels.inertialization import place_row
from verbs.kernels.legs import Legs, plant
from verbs.kernels.one_leg import SCRATCH
from verbs.kernels.pose import forward, global_rotations
from verbs.runtime.characters import Characters, Frames, Step
from verbs.runtime.evaluate import Blend, Evaluator

__all__ = ["Step", "pack", "pack_step", "warm"]


class _Heads(NamedTuple):
    """What the heads of the records of B characters contain."""

    progress: Records
    error: F64
    clamped: Flags
    in_transition: Flags


class _Posed(NamedTuple):
    """Weights and poses of R of them, whose numbers are ``chosen``; ``world`` are global rotations."""

    chosen: I64
    weights: F64
    root: F64
    local: F64
    world: F64


class _Sums(NamedTuple):
    """Characters whose poses are sums of curves: ``slots`` of all, numbers of the ``chosen``, state and weights.

    ``commands`` and ``legs`` plant their feet.
    """

    slots: I64
    chosen: I64
    state: Records
    weights: F64
    curves: Curves
    striding: bool
    parents: I64
    commands: F64
    legs: Legs


class _Words(NamedTuple):
    """One buffer as words, floats and half words."""

    words: U32
    floats: F32
    halves: U16


def pack(frames: Frames, global_rotations: F64, version: int, targets: Targets, words: U32) -> None:
    """Write one record per character into ``words``.

    ``global_rotations`` are (B, J, 4); the local ones serve where no record has global ones.
    """
    blend = frames.blend
    heads = _Heads(frames.progress, blend.error, blend.clamped, frames.in_transition)
    chosen = np.arange(len(frames.root))
    posed = _Posed(chosen, blend.weights, frames.root, frames.rotations, global_rotations)
    _pack_direct(heads, posed, targets, version, _words(words))


def pack_step(characters: Characters, slots: I64, step_s: float, version: int, targets: Targets, words: U32) -> Step:
    """Step characters, and write one record for each into ``words``.

    Nothing is allocated per character but what is returned; no two calls for the same characters may run at once.

    Parameters
    ----------
    characters : Characters
    slots : (B,) int64
        C-contiguous, each at most once.
    step_s : float
        Seconds, above 0.
    version : int
        Version of the verb.
    targets : Targets
        Of the B characters; where ``at`` is -1 the character moves, and no record is written.
    words : (…,) uint32
    """
    step = characters.advance(slots, step_s)
    heads, buffer = _Heads(*step[:4]), _words(words)
    parents, crowd = characters.verb.skeleton.parents, characters.crowd
    if len(step.complete):
        source = _Sums(
            slots, step.complete, crowd.state, crowd.weights, characters.curves, characters.striding, parents,
            crowd.commands, characters.planting.legs,
        )  # fmt: skip
        _pack_sums_direct(heads, source, targets, version, buffer)
    if len(step.rest):
        world, positions = np.empty_like(step.rotations), np.empty((len(step.rest), len(parents), 3))
        forward(step.root, step.rotations, parents, characters.verb.skeleton.offsets, world, positions)
        posed = _Posed(step.rest, step.weights, step.root, step.rotations, world)
        _pack_direct(heads, posed, targets, version, buffer)
    return step


def _words(words: U32) -> _Words:
    return _Words(words, words.view(np.float32), words.view(np.uint16))


def warm() -> None:
    """Compile or load the kernels before the first frame."""
    layout = Layout("q48", "local", "gltf", np.zeros(1, np.int64), 1)
    unit = np.array([[[0.0, 0.0, 0.0, 1.0]]])
    blend = Blend("", np.ones((1, 1)), np.zeros((1, 0)), np.zeros(1), np.zeros(1, np.bool_))
    frames = Frames(blend, np.zeros(1, PROGRESS), np.zeros((1, 3)), unit, np.zeros(1, np.bool_))
    pack(frames, unit, 1, Targets.of([layout], [0], [0]), np.zeros(layout.words, np.uint32))
    characters = Characters(Evaluator(library.load("arm3")))
    slots, targets = np.array([characters.add()]), Targets.of([replace(layout, encoding="f32")], [0], [0])
    for _ in range(2):  # in a transition, and without one
        pack_step(characters, slots, 0.01, 1, targets, np.zeros(64, np.uint32))
        slots = np.array([characters.go_on(characters, int(slots[0]))])


@kernel
def _pack(heads: _Heads, posed: _Posed, targets: Targets, version: int, buffer: _Words) -> None:
    """Records of characters whose poses are computed."""
    for r in range(posed.chosen.shape[0]):
        b = posed.chosen[r]
        if targets.at[b] < 0:
            continue
        to = _write_head(b, heads, targets, version, buffer.words, buffer.floats)
        if targets.layouts[b, 0] == WEIGHTS:
            _write_weights(posed.weights[r], to, buffer.words, buffer.floats)
            continue
        rotations = posed.world[r] if targets.layouts[b, 1] == 1 else posed.local[r]
        _write_pose(b, to, posed.root[r], rotations, targets, buffer)


_pack_direct = direct(_pack)


@kernel
def _pack_sums(heads: _Heads, source: _Sums, targets: Targets, version: int, buffer: _Words) -> None:
    """Records of characters whose poses are sums of curves, each sum normalised and written once.

    They go through in tiles, sorted by knot interval; see :mod:`verbs.kernels.crowd_pose`.
    """
    slots, chosen, state, weights, curves, striding, parents, commands, legs = source
    rows, intervals, mode, references = curves
    needed, order, count = np.empty(chosen.shape[0], np.int64), np.empty(chosen.shape[0], np.int64), 0
    phases = np.empty(slots.shape[0])
    for c in range(chosen.shape[0]):
        b = chosen[c]
        if targets.at[b] >= 0:
            phases[b] = heads.progress[b]["phase"]
            needed[count] = b
            count += targets.layouts[b, 0] != WEIGHTS
            if targets.layouts[b, 0] == WEIGHTS:
                to = _write_head(b, heads, targets, version, buffer.words, buffer.floats)
                _write_weights(weights[slots[b], state[slots[b]]["weights"]], to, buffer.words, buffer.floats)
    sort_by_interval(needed[:count], phases, intervals, order)
    most, width = min(TILE, count), rows.shape[1]
    shares, tile = np.empty((most, 4 * weights.shape[2]), np.float32), np.empty((most, width), np.float32)
    scales, at, taps = np.empty(most * width // 4, np.float32), np.empty(most, np.int64), np.empty(4)
    world, scratch = np.empty((parents.shape[0], 4)), np.empty((legs.chains.shape[0], SCRATCH))
    for start in range(0, count, TILE):
        size = min(TILE, count - start)
        for k in range(size):
            s = slots[order[start + k]]
            at[k] = share(weights[s, state[s]["weights"]], phases[order[start + k]], intervals, taps, shares[k])
        sums(shares[:size], at[:size], rows, tile[:size])
        finish_single(tile[:size], scales, mode, references)
        for k in range(size):
            b = order[start + k]
            place_row(state[slots[b]], striding, tile[k])
            if state[slots[b]]["footed"] > 0.0:
                plant(tile[k, :3], tile[k, 4:].reshape(parents.shape[0], 4), commands[slots[b], 0], legs, scratch)
            to = _write_head(b, heads, targets, version, buffer.words, buffer.floats)
            if targets.layouts[b, 3] == 1:
                _write_plain(targets.layouts[b, 0], tile[k], targets.spans[b, 1] - targets.spans[b, 0], to, buffer)
                continue
            rotations = tile[k, 4:].reshape(parents.shape[0], 4)
            if targets.layouts[b, 1] == 1:
                global_rotations(rotations, parents, world)
                _write_pose(b, to, tile[k], world, targets, buffer)
            else:
                _write_pose(b, to, tile[k], rotations, targets, buffer)


_pack_sums_direct = direct(_pack_sums)


@kernel
def _write_head(b: int, heads: _Heads, targets: Targets, version: int, words: U32, floats: F32) -> int:
    """Write the head of one record; return the first word of its payload."""
    to, step = targets.at[b], heads.progress[b]
    flags = (CLAMPED if heads.clamped[b] else 0) | (IN_TRANSITION if heads.in_transition[b] else 0)
    flags |= LAST if step["ended"] > 0.0 else 0
    words[to] = targets.heads[b] | (targets.layouts[b, 0] << 16) | (flags << 24)
    words[to + 1] = version
    floats[to + 2], floats[to + 3] = step["phase"], step["time_s"]
    floats[to + 4], floats[to + 5] = heads.error[b], step["duration_s"]
    return int(to + HEAD_WORDS)


@kernel
def _write_weights(weights: F64, to: int, words: U32, floats: F32) -> None:
    """Write the payload of a record of weights (N,)."""
    words[to] = weights.shape[0]
    for i in range(weights.shape[0]):
        floats[to + 1 + i] = weights[i]


@kernel
def _write_plain(encoding: int, row: F32, joints: int, to: int, buffer: _Words) -> None:
    """Write the payload of the first joints of a row (4 + 4·J,), in the space and frame that it is in."""
    words, floats, halves = buffer.words, buffer.floats, buffer.halves
    for a in range(3):
        floats[to + a] = row[a]
    to += 3
    if encoding == F32_ENCODING:
        for c in range(4 * joints):
            floats[to + c] = row[4 + c]
        return
    if encoding == Q48 and joints % 2:
        words[to + (3 * joints) // 2] = 0
    for j in range(joints):
        x, y, z, w = row[4 * j + 4], row[4 * j + 5], row[4 * j + 6], row[4 * j + 7]
        if encoding == Q48:
            _three_in_48(x, y, z, w, 2 * to + 3 * j, halves)
        else:
            words[to + j] = _three_in_32(x, y, z, w)


@kernel
def _write_pose(b: int, to: int, root: Any, rotations: Any, targets: Targets, buffer: _Words) -> None:
    """Write the payload of any layout of a root (3,) and rotations (J, 4) in the layout's space."""
    words, floats, halves = buffer.words, buffer.floats, buffer.halves
    encoding, frame = targets.layouts[b, 0], targets.layouts[b, 2]
    for a in range(3):
        floats[to + a] = UNITS[frame] * SIGN[frame, a] * root[SOURCE[frame, a]]
    to += 3
    first, last = targets.spans[b, 0], targets.spans[b, 1]
    if encoding == Q48 and (last - first) % 2:
        words[to + (3 * (last - first)) // 2] = 0
    for k in range(first, last):
        q = rotations[targets.joints[k]]
        x = DETERMINANT[frame] * SIGN[frame, 0] * q[SOURCE[frame, 0]]
        y = DETERMINANT[frame] * SIGN[frame, 1] * q[SOURCE[frame, 1]]
        z = DETERMINANT[frame] * SIGN[frame, 2] * q[SOURCE[frame, 2]]
        w = q[3]
        if encoding == F32_ENCODING:
            word = to + 4 * (k - first)
            floats[word], floats[word + 1], floats[word + 2], floats[word + 3] = x, y, z, w
        elif encoding == Q48:
            _three_in_48(x, y, z, w, 2 * to + 3 * (k - first), halves)
        else:
            words[to + k - first] = _three_in_32(x, y, z, w)


@kernel
def _three(x: float, y: float, z: float, w: float) -> tuple[int, float, float, float]:
    """Which of four components of a quaternion is the largest, and the others where it is positive, times √2."""
    largest, value = 0, x
    if abs(y) > abs(value):
        largest, value = 1, y
    if abs(z) > abs(value):
        largest, value = 2, z
    if abs(w) > abs(value):
        largest, value = 3, w
    scale = np.sqrt(2.0) * (-1.0 if value < 0.0 else 1.0)
    a = y if largest == 0 else x
    b = y if largest > 1 else z
    c = z if largest == 3 else w
    return largest, scale * a, scale * b, scale * c


@kernel
def _three_in_48(x: float, y: float, z: float, w: float, to: int, halves: U16) -> None:
    """Write three of four components of a unit quaternion, 15 bits each, and which one was left out."""
    largest, a, b, c = _three(x, y, z, w)
    halves[to] = _steps(a, Q48_SCALE) | ((largest & 1) << 15)
    halves[to + 1] = _steps(b, Q48_SCALE) | ((largest >> 1) << 15)
    halves[to + 2] = _steps(c, Q48_SCALE)


@kernel
def _three_in_32(x: float, y: float, z: float, w: float) -> int:
    """Three of four components of a unit quaternion, 10 bits each, and which one was left out, as one word."""
    largest, a, b, c = _three(x, y, z, w)
    low, middle, high = _steps(a, Q32_SCALE), _steps(b, Q32_SCALE), _steps(c, Q32_SCALE)
    return low | (middle << 10) | (high << 20) | (largest << 30)


@kernel
def _steps(value: float, scale: float) -> int:
    """A number within ±1 as 0 … 2 · scale."""
    return int(min(max(np.floor(value * scale + 0.5), -scale), scale)) + int(scale)
