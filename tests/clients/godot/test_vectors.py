"""The Godot addon against the test vectors of the wire and of evaluators."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from adverb_client import Layout, decode_message

from tests.clients import jitter_plan
from tests.clients.godot.godot import run
from tests.golden import make_wire_vectors
from tools import evaluator_vectors

VECTORS = json.loads(make_wire_vectors.PATH.read_text("utf-8"))
EVALUATOR = json.loads(evaluator_vectors.PATH.read_text("utf-8"))
DIGITS = 1e-12  # of numbers that the programs print


@pytest.fixture(scope="module")
def wire(project):
    return run(project, "vectors", "wire", str(make_wire_vectors.PATH))


@pytest.mark.parametrize("k", range(len(VECTORS["pose_messages"])))
def test_pose_messages_are_decoded(wire, k):
    vector, found = VECTORS["pose_messages"][k], wire["poses"][k]
    assert found["problem"] == ""
    assert [found["sequence"], found["dropped"]] == [vector["header"]["sequence"], vector["header"]["dropped"]]
    assert int(found["time_ns"]) % 2**64 == int(vector["header"]["time_ns"])  # Godot has no unsigned numbers
    layouts = {int(number): Layout.from_opened(**layout) for number, layout in vector["layouts"].items()}
    python = list(decode_message(bytes.fromhex(vector["hex"]), layouts).records())
    for row, expected, reference in zip(found["records"], vector["records"], python, strict=True):
        assert [row[name] for name in ("channel", "flags", "version")] == [
            expected[name] for name in ("channel", "flags", "version")
        ]
        for name, other in (("phase", "phase"), ("time_s", "time"), ("duration_s", "duration"), ("error", "error")):
            assert row[name] == (None if expected[other] is None else pytest.approx(expected[other], abs=DIGITS))
        same = reference.weights if reference.root is None else np.append(reference.root, reference.rotations)
        np.testing.assert_allclose(row["values"], same, atol=1e-6)


def test_malformed_pose_messages_are_rejected(wire):
    assert all(wire["malformed"])
    assert len(wire["malformed"]) == len(VECTORS["malformed_pose_messages"])


def test_layouts_are_checked(wire):
    for found, expected in zip(wire["layouts"], VECTORS["layouts"], strict=True):
        assert found == (expected["rejection"] is None), expected


def test_text_messages_are_checked(wire):
    assert wire["texts"] == [""] * len(VECTORS["server_messages"])
    for problem, row in zip(wire["malformed_texts"], VECTORS["malformed_server_messages"], strict=True):
        assert problem, row["reason"]


@pytest.mark.parametrize("encoding", ["q48", "q32"])
def test_words_are_decoded(wire, encoding):
    for found, row in zip(wire[encoding], VECTORS[encoding]["decode"], strict=True):
        np.testing.assert_allclose(found, row["rotation"], atol=1e-9)


def test_adverbs_are_encoded(wire):
    assert wire["one"] == [row["hex"] for row in VECTORS["adverb_messages"]]
    assert wire["many"] == [row["hex"] for row in VECTORS["bulk_adverb_messages"]]


def test_clocks_and_lateness_are_estimated(wire):
    for found, row in zip(wire["clocks"], VECTORS["clocks"], strict=True):
        assert found == pytest.approx([row["offset_s"], row["round_trip_s"]], abs=VECTORS["tolerances"]["seconds"])
    for found, row in zip(wire["lateness"], VECTORS["jitter"], strict=True):
        expected = [row["min_transit_s"], row["lateness_s"]]
        assert found == pytest.approx(expected, abs=VECTORS["tolerances"]["seconds"])


@pytest.mark.parametrize(
    "options",
    [{"looping": False}, {"looping": True}, {"looping": True, "weights": True}, {"looping": False, "irregular": True}],
    ids=["motion", "loop", "weights", "irregular"],
)
def test_the_jitter_buffer_displays_what_the_python_client_displays(project, tmp_path, options):
    plan = jitter_plan.schedule(3, **options)
    path = tmp_path / "schedule.json"
    path.write_text(json.dumps(plan))
    found, expected = run(project, "vectors", "jitter", str(path)), list(jitter_plan.reference(plan))
    assert sum(sample is not None for sample in expected) > 400
    assert any(sample.held for sample in expected if sample)
    for row, sample in zip(found, expected, strict=True):
        assert (row is None) == (sample is None)
        if row is None:
            continue
        names = ("server_time_s", "phase", "time_s", "duration_s", "delay_s", "extrapolated_s")
        assert [row[name] for name in names] == pytest.approx([getattr(sample, name) for name in names], abs=1e-9)
        assert row["error"] == (None if math.isnan(sample.error) else pytest.approx(sample.error, abs=1e-6))
        for name in ("version", "clamped", "in_transition", "ended", "held"):
            assert row[name] == getattr(sample, name), name
        values = sample.weights if sample.root is None else np.append(sample.root, sample.rotations)
        np.testing.assert_allclose(row["values"], values, atol=1e-6)


def test_errors_of_a_server_that_restarts_are_no_answers(project):
    (opened, *_) = (row["text"] for row in VECTORS["server_messages"] if row["text"].startswith('{"op": "opened"'))
    found = run(project, "vectors", "session_errors", json.dumps({**json.loads(opened), "channel": 0}))
    assert found == {
        "open": ["open"],
        "channel_in_use": ["close", "open"],
        "unknown_channel": [],
        "not_ready": [],
        "early": [],
        "retry": ["open"],
        "opened": [],
        "events": ["opened"],
    }


@pytest.fixture(scope="module")
def evaluated(project):
    return run(project, "vectors", "evaluate", str(evaluator_vectors.PATH), str(evaluator_vectors.ROOT))


@pytest.mark.parametrize("k", range(len(EVALUATOR["verbs"])), ids=[row["file"] for row in EVALUATOR["verbs"]])
@pytest.mark.parametrize("kind", ["weights", "adverbs"])
def test_golden_poses_are_evaluated(evaluated, k, kind):
    assert evaluated[k]["problem"] == ""
    for found, expected in zip(evaluated[k][kind], EVALUATOR["verbs"][k][kind], strict=True):
        assert found["at"] == pytest.approx(list(expected["at"].values()), abs=1e-6)
        assert found["clamped"] == expected.get("clamped", False)
        assert found["weights"] == pytest.approx(expected["weights"], abs=1e-7)
        distances = np.linalg.norm(np.reshape(found["positions"], (-1, 3)) - expected["positions"], axis=1)
        assert distances.max() <= EVALUATOR["tolerance_m"]


def test_damaged_files_are_rejected(project):
    *damaged, whole = run(project, "vectors", "damage", str(evaluator_vectors.ROOT / "tests/golden/arm.v1.verb"))
    assert all(damaged)
    assert whole == ""
