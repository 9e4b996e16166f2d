"""The C# client against the test vectors of the wire and of evaluators, and against the Python client."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from adverb_client import Layout, decode_message
from adverb_client.skeleton import Skeleton

from tests.clients import jitter_plan
from tests.clients.csharp.mono import run
from tests.golden import make_wire_vectors
from tools import evaluator_vectors

VECTORS = json.loads(make_wire_vectors.PATH.read_text("utf-8"))
EVALUATOR = json.loads(evaluator_vectors.PATH.read_text("utf-8"))
TOLERANCE_M = 1e-5
F32 = 6e-8  # of numbers that the program prints with nine digits


@pytest.fixture(scope="module")
def wire(program):
    return run(program, "wire", str(make_wire_vectors.PATH))


def chain(joints):
    """A skeleton in a row, with limbs of 0.1 m."""
    names = tuple(f"joint {j}" for j in range(joints))
    limbs = np.full((joints, 3), (0.1, 0.0, 0.0))
    return Skeleton(names, np.arange(joints) - 1, limbs, np.zeros(0, np.int64), np.zeros((0, 3)))


def places(values):
    """Joint positions of a root and rotations of a chain."""
    numbers = np.array(values, np.float64)
    return chain((len(numbers) - 3) // 4).positions(numbers[:3], numbers[3:].reshape(-1, 4))


@pytest.mark.parametrize("k", range(len(VECTORS["pose_messages"])))
def test_pose_messages_are_decoded(wire, k):
    vector, found = VECTORS["pose_messages"][k], wire["poses"][k]
    header = vector["header"]
    assert [found[name] for name in ("sequence", "time_ns", "dropped")] == [
        header[name] for name in ("sequence", "time_ns", "dropped")
    ]
    layouts = {int(number): Layout.from_opened(**layout) for number, layout in vector["layouts"].items()}
    python = list(decode_message(bytes.fromhex(vector["hex"]), layouts).records())
    for row, expected, reference in zip(found["records"], vector["records"], python, strict=True):
        assert [row[name] for name in ("channel", "flags", "version")] == [
            expected[name] for name in ("channel", "flags", "version")
        ]
        for name in ("phase", "time", "duration", "error"):
            assert row[name] == (None if expected[name] is None else pytest.approx(expected[name], rel=F32))
        if "weights" in expected:
            np.testing.assert_allclose(row["values"], expected["weights"], rtol=F32)
            continue
        same = np.concatenate([reference.root, reference.rotations.ravel()])
        np.testing.assert_allclose(places(row["values"]), places(same), atol=TOLERANCE_M, rtol=F32)


def test_malformed_pose_messages_are_rejected(wire):
    assert wire["malformed"] == ["malformed"] * len(VECTORS["malformed_pose_messages"])


def test_layouts_are_checked(wire):
    for found, expected in zip(wire["layouts"], VECTORS["layouts"], strict=True):
        assert found == (expected["record_bytes"] if expected["rejection"] is None else None), expected


@pytest.mark.parametrize("encoding", ["q48", "q32"])
def test_words_are_decoded(wire, encoding):
    for found, row in zip(wire[encoding], VECTORS[encoding]["decode"], strict=True):
        unit = np.array(row["rotation"]) / np.linalg.norm(row["rotation"])
        assert min(np.abs(found - unit).max(), np.abs(found + unit).max()) < 1e-6


def test_adverbs_are_encoded(wire):
    assert wire["one"] == [row["hex"] for row in VECTORS["adverb_messages"]]
    assert wire["many"] == [row["hex"] for row in VECTORS["bulk_adverb_messages"]]


def test_clocks_and_delays_are_estimated(wire):
    for found, row in zip(wire["clocks"], VECTORS["clocks"], strict=True):
        assert found == pytest.approx([row["offset_s"], row["round_trip_s"]], abs=VECTORS["tolerances"]["seconds"])
    for found, row in zip(wire["lateness"], VECTORS["jitter"], strict=True):
        expected = [row["min_transit_s"], row["lateness_s"], row["delay_s"]]
        assert found == pytest.approx(expected, abs=VECTORS["tolerances"]["seconds"])


def test_json_is_written_as_it_was_read(wire):
    assert wire["texts"] == [row["fields"] for row in VECTORS["client_messages"]]


def test_damaged_messages_have_no_other_errors(wire):
    assert 10_000 < wire["damaged"] < 40_000


def test_frames_are_decoded_and_displayed_without_allocation(wire):
    assert wire["allocated"] < 20_000, "20,000 frames allocate a byte each or more"


# --- jitter buffer ---


@pytest.mark.parametrize(
    "options",
    [{"looping": False}, {"looping": True}, {"looping": True, "weights": True}, {"looping": False, "irregular": True}],
    ids=["motion", "loop", "weights", "irregular"],
)
def test_the_jitter_buffer_displays_what_the_python_client_displays(program, tmp_path, options):
    plan = jitter_plan.schedule(3, **options)
    path = tmp_path / "schedule.json"
    path.write_text(json.dumps(plan))
    found = run(program, "jitter", str(path))["samples"]
    expected = list(jitter_plan.reference(plan))
    assert sum(sample is not None for sample in expected) > 400
    assert any(sample.held for sample in expected if sample)
    for row, sample in zip(found, expected, strict=True):
        assert (row is None) == (sample is None)
        if row is None:
            continue
        numbers = [sample.server_time_s, sample.phase, sample.time_s, sample.duration_s, sample.delay_s]
        assert row["numbers"] == pytest.approx([*numbers, sample.extrapolated_s], abs=1e-9)
        assert row["error"] == (None if math.isnan(sample.error) else pytest.approx(sample.error, abs=1e-6))
        flags = [sample.clamped, sample.in_transition, sample.ended, sample.held, options.get("weights", False)]
        assert (row["flags"], row["version"]) == (flags, sample.version)
        values = sample.weights if sample.root is None else np.append(sample.root, sample.rotations)
        np.testing.assert_allclose(row["values"], values, atol=1e-6)


# --- evaluator ---


@pytest.fixture(scope="module")
def evaluated(program):
    return run(program, "evaluate", str(evaluator_vectors.PATH), str(evaluator_vectors.ROOT))


@pytest.mark.parametrize("k", range(len(EVALUATOR["verbs"])), ids=[row["file"] for row in EVALUATOR["verbs"]])
@pytest.mark.parametrize("kind", ["weights", "adverbs"])
def test_golden_poses_are_evaluated(evaluated, k, kind):
    for found, expected in zip(evaluated[k][kind], EVALUATOR["verbs"][k][kind], strict=True):
        assert found["at"] == pytest.approx(list(expected["at"].values()), abs=1e-6)
        assert found["clamped"] == expected.get("clamped", False)
        assert found["weights"] == pytest.approx(expected["weights"], abs=1e-7)
        distances = np.linalg.norm(np.reshape(found["positions"], (-1, 3)) - expected["positions"], axis=1)
        assert distances.max() <= EVALUATOR["tolerance_m"]


def test_damaged_files_and_wrong_arguments_are_rejected(program):
    found = run(program, "damage", str(evaluator_vectors.ROOT / "tests" / "golden" / "arm.v1.verb"))
    expected = ["checksum", "does not fit", "too short", "safetensors", "format 9", "header is invalid"]
    expected += ["missing adverb y", "unknown adverb z", "not finite", "0 to 1", "not magic", "5 examples"]
    for row, part in zip(found[:-1], expected, strict=True):
        assert part in row
    assert found[-1] is None, "a pose in the middle of the domain is no error"
    assert [row.partition(":")[0] for row in found[:6]] == ["artifact_invalid"] * 6
