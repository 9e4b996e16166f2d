from __future__ import annotations

import shutil
import tomllib

import numpy as np
import pytest

from tests.verbs import broken_clips as broken
from tests.verbs import raw_folder, walker
from tests.verbs.proposal.test_keytimes import repeated
from verbs.authoring.fit import build
from verbs.errors import SourceError, UnknownName
from verbs.io import bvh, npz
from verbs.proposal.clips import clip_of
from verbs.proposal.propose import propose, write
from verbs.proposal.result import Options
from verbs.quality.leave_one_out import left_out_errors


@pytest.fixture(scope="module")
def awkward(tmp_path_factory):
    """The proposal for the folder of clips that do not fit together, written."""
    folder = raw_folder.awkward_folder(tmp_path_factory.mktemp("raw") / "Reach set 1")
    proposal = propose(folder)
    write(proposal, folder)
    return folder, proposal


@pytest.mark.parametrize("name", raw_folder.AWKWARD)
def test_each_awkward_clip_is_named_with_what_to_do(awkward, name):
    _, proposal = awkward
    (odd,) = [odd for odd in proposal.report()["excluded"] if odd["file"] == name]
    assert raw_folder.AWKWARD[name] in odd["problem"]
    assert odd["advice"]
    assert name in proposal.text


def test_the_other_clips_become_a_verb(awkward):
    folder, proposal = awkward
    kept = {row.file for row in proposal.rows if not row.excluded}
    assert kept == {*(f"reach_{k}.bvh" for k in range(9)), "rate.bvh", *raw_folder.MENDED}
    built = build(folder)
    assert built.verb.name == "reach_set_1"
    assert built.verb.skeleton.names[built.verb.measure.effector] == "RightHand"
    assert not [warning for warning in built.warnings if "stored adverbs" in warning]
    values = tomllib.loads(proposal.text)["example"]
    stored = np.array([row["adverb_values"] for row in values])
    assert np.abs(stored - built.verb.values).max() < 1e-4


@pytest.mark.parametrize("name", raw_folder.MENDED)
def test_clips_that_can_be_mended_are(awkward, name):
    folder, proposal = awkward
    kind, joint = raw_folder.MENDED[name]
    (row,) = [row for row in proposal.rows if row.file == name]
    assert any(remark.startswith("mended: ") for remark in row.remarks)
    (table,) = [one for one in tomllib.loads(proposal.text)["mend"] if one["example"] == name.removesuffix(".bvh")]
    assert (table["kind"], table.get("joint")) == (kind, joint)
    built = build(folder).verb
    yaw, pitch = {"spinning.bvh": (-0.3, 0.3), "backwards.bvh": (-0.3, -0.2)}[name]
    motion = raw_folder.reach(yaw, pitch, frames=90 if name == "spinning.bvh" else 91)
    hand = clip_of(folder / name, motion).path_of(motion.skeleton.index("RightHand"), np.array([row.keytimes.times[1]]))
    assert built.values[built.examples.index(name.removesuffix(".bvh"))] == pytest.approx(hand[0], abs=0.02)


def test_apexes_and_their_confidence(awkward):
    _, proposal = awkward
    rows = {row.file: row.keytimes for row in proposal.rows}
    for k, motion in enumerate(raw_folder.reaches().values()):
        times = rows[f"reach_{k}.bvh"].times
        assert times[1] == pytest.approx((0.42 + 0.015 * k) * motion.duration_s, abs=0.05)
        assert rows[f"reach_{k}.bvh"].confidence[1] > 0.8


def test_an_existing_source_is_kept(awkward, tmp_path):
    folder, proposal = awkward
    (tmp_path / "verb.toml").write_text("mine")
    with pytest.raises(SourceError, match="--force"):
        write(proposal, tmp_path)
    assert (tmp_path / "verb.toml").read_text() == "mine"
    write(proposal, tmp_path, force=True)
    assert (tmp_path / "verb.toml").read_text() == (folder / "verb.toml").read_text()


def test_centimetres_are_recognised(tmp_path):
    motions = {name: raw_folder.scaled(motion, 100.0) for name, motion in raw_folder.reaches().items()}
    proposal = propose(raw_folder.write(tmp_path / "reach", motions))
    assert proposal.head.unit == "cm"
    assert "1." in proposal.head.evidence["unit"]
    write(proposal, tmp_path / "reach")
    assert np.abs(build(tmp_path / "reach").verb.values).max() < 2.0


def test_axes_of_the_files_are_found_and_the_source_builds(tmp_path):
    """Files with +Z up and -Y forward give the adverbs that files with +Y up and +Z forward give."""
    upright = propose(raw_folder.write(tmp_path / "upright", raw_folder.reaches()))
    lying = {name: raw_folder.zup(motion) for name, motion in raw_folder.reaches().items()}
    folder = raw_folder.write(tmp_path / "reach", lying)
    proposal = propose(folder)
    assert (proposal.head.up, proposal.head.forward) == ("+Z", "-Y")
    for one, other in zip(proposal.rows, upright.rows, strict=True):
        assert one.values == pytest.approx(other.values, abs=1e-4)
    write(proposal, folder)
    built = build(folder)
    assert built.verb.values == pytest.approx(np.array([row.values for row in upright.rows]), abs=1e-3)


def test_clips_may_be_of_any_format(tmp_path):
    folder = raw_folder.write(tmp_path / "reach", raw_folder.reaches())
    motion = bvh.read(folder / "reach_3.bvh")
    (folder / "reach_3.bvh").unlink()
    npz.write(motion, folder / "reach_3.npz")
    proposal = propose(folder)
    assert [row.file for row in proposal.rows if row.file.startswith("reach_3")] == ["reach_3.npz"]
    assert len(proposal.rows) == 9


def test_duplicates_are_excluded(tmp_path):
    motions = raw_folder.reaches()
    motions["copy"] = motions["reach_2"]
    proposal = propose(raw_folder.write(tmp_path / "reach", motions))
    assert [(odd.name, odd.problem) for odd in proposal.refused] == [
        ("reach_2.bvh", "is the same motion as copy.bvh")
    ]  # fmt: skip


def test_style_adverbs_from_names_and_from_a_table(tmp_path):
    motions = {f"reach_{0.5 * (k % 3):.1f}_{k}": m for k, m in enumerate(raw_folder.reaches().values())}
    folder = raw_folder.write(tmp_path / "reach", motions)
    by_name = propose(folder, Options(pattern="reach_{tired:float}_{n}.bvh"))
    table = tmp_path / "styles.csv"
    table.write_text("file,tired\n" + "".join(f"{name},{name.split('_')[1]}\n" for name in motions))
    by_table = propose(folder, Options(style_csv=table))
    for proposal in (by_name, by_table):
        assert proposal.head.adverbs[-1] == ("tired", "none", "style", True)
        assert [row.values[-1] for row in proposal.rows] == [float(row.file.split("_")[1]) for row in proposal.rows]
    table.write_text("file,tired\nreach_0.0_0,1\n")
    with pytest.raises(SourceError, match="has no style adverbs"):
        propose(folder, Options(style_csv=table))
    table.write_text("file,tired\nreach_0.0_0,much\n")
    with pytest.raises(SourceError, match="line 2"):
        propose(folder, Options(style_csv=table))
    with pytest.raises(SourceError, match="float"):
        propose(folder, Options(pattern="reach_{tired}_{n}.bvh"))


def test_wrong_options_are_named(tmp_path):
    folder = raw_folder.write(tmp_path / "reach", raw_folder.reaches())
    with pytest.raises(UnknownName, match="Tail"):
        propose(folder, Options(effector="Tail"))
    for given, problem in (
        ({"none.bvh": (0.0, 1.0)}, "none of the clips"),
        ({"reach_0": (0.0, 2.0, 1.0)}, "ascending"),
        ({"reach_0": (0.0, 99.0)}, "must lie from 0"),
        ({"reach_0": (0.0, 1.0), "reach_1": (0.0, 0.5, 1.0)}, "same number"),
    ):
        with pytest.raises(SourceError, match=problem):
            propose(folder, Options(annotated=given))
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no motion files"):
        propose(tmp_path / "empty")


@pytest.mark.parametrize("zup", [False, True])
def test_long_walks_become_cycles(tmp_path, zup):
    folder = tmp_path / "walk"
    folder.mkdir()
    for speed in (0.7, 0.9, 1.1, 1.3):
        walk = repeated(walker.walk(speed), 5)
        bvh.write(raw_folder.zup(walk) if zup else walk, folder / f"walk_{speed}.bvh", decimals=7)
    proposal = propose(folder)
    assert proposal.head.measure == "root_velocity"
    assert proposal.head.looping
    assert [row.values[0] for row in proposal.rows] == pytest.approx([0.7, 0.9, 1.1, 1.3], rel=0.02)
    assert all("seam" in row.remarks[0] for row in proposal.rows)
    assert proposal.problem  # they only go straight: three speeds are not determined
    write(proposal, folder)
    assert sorted(path.name for path in folder.glob("*_cycle.bvh")) == [row.file for row in proposal.rows]
    again = propose(folder)
    assert [row.file for row in again.rows] == [row.file for row in proposal.rows]
    assert (again.head.up, again.head.forward) == (("+Z", "-Y") if zup else ("+Y", "+Z"))
    for one, other in zip(again.rows, proposal.rows, strict=True):
        assert one.values == pytest.approx(other.values, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wrong", "reason"),
    [
        ("punch", "kick/KickForwardMedium.bvh", "does not belong"),
        ("jump", "reach/ReachBackLow.bvh", "is no jump"),
        ("reach", "jump/JumpUpHigh.bvh", "does not belong"),
        ("kick", "punch/PunchForwardMediumFar.bvh", "predict it badly"),
    ],
)
def test_a_captured_clip_of_another_action_is_named(mocap, tmp_path, name, wrong, reason):
    folder = tmp_path / name
    folder.mkdir()
    for path in [*(mocap / name).glob("*.bvh"), mocap / wrong]:
        shutil.copy(path, folder)
    proposal = propose(folder)
    odd = {row.file: " ".join([row.excluded, *row.remarks]).strip() for row in proposal.rows}
    found = {file: words for file, words in odd.items() if words}
    assert set(found) == {wrong.split("/")[1]}
    assert reason in next(iter(found.values()))
    assert proposal.verb is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "measure", "effector"),
    [
        ("punch", "joint_position", "RightHand"),
        ("kick", "joint_position", "RightFoot"),
        ("jump", "jump", ""),
        ("locomotion", "root_velocity", ""),
    ],
)
def test_a_captured_set_without_its_source(mocap, tmp_path, verb_of, name, measure, effector):
    table = tomllib.loads((mocap / name / "verb.toml").read_text())
    folder = tmp_path / name
    folder.mkdir()
    for row in table["example"]:
        shutil.copy(mocap / name / row["file"], folder)
    row = table["example"][1]
    proposal = propose(folder, Options(annotated={row["file"]: tuple(row["keytimes"])}))
    assert (proposal.head.measure, proposal.head.effector) == (measure, effector)
    assert not [row for row in proposal.rows if row.excluded]
    annotated = verb_of(name)
    own = float(np.degrees(left_out_errors(annotated, ("corrected",))[0].mean()))
    assert np.mean(list(proposal.left_out_deg.values())) <= 1.05 * own
    same = {row["file"]: tuple(row["keytimes"]) for row in table["example"]}
    for row, expected in zip(
        propose(folder, Options(annotated=same)).rows, _by_file(table, annotated.values), strict=True
    ):
        found = np.array(row.values)
        if measure == "joint_position":
            assert np.abs(found - expected).max() < 1e-3
        elif measure == "jump":  # distance and direction as a displacement: jumps in place have no direction
            reached, stated = (v[0] * np.array([np.sin(v[1]), np.cos(v[1])]) for v in (found, expected))
            assert np.linalg.norm(reached - stated) < 0.01 * max(expected[0], 0.1)
            assert found[2] == pytest.approx(expected[2], rel=0.01)
        else:
            assert np.abs(found - expected).max() < 0.01 * max(1.0, np.abs(expected).max())


def _by_file(table, values):
    """Rows of values of the examples, in the order of their files' names."""
    order = np.argsort([row["file"] for row in table["example"]])
    return values[order]


def test_calibration_poses_are_cut_off_and_keytimes_are_those_of_the_files(tmp_path):
    """Each clip begins with a T-pose, as in many public sets."""
    plain, posed = tmp_path / "plain", tmp_path / "posed"
    for folder in (plain, posed):
        folder.mkdir()
    for file in sorted((broken.LIBRARY / "punch").glob("*.bvh")):
        motion = bvh.read(file)
        bvh.write(motion, plain / file.name)
        bvh.write(broken.calibrated(motion, 3), posed / file.name)
    expected, proposal = propose(plain), propose(posed)
    write(proposal, posed)
    for one, other in zip(expected.rows, proposal.rows, strict=True):
        assert {mend.kind for mend in other.mends} == {"cut"}
        assert np.array(other.marks) - 3 / 60 == pytest.approx(one.marks, abs=1e-4)
        assert other.values == pytest.approx(one.values, abs=1e-4)
    built = build(posed)
    np.testing.assert_allclose(built.verb.values, [row.values for row in proposal.rows], atol=1e-4)
    assert not [warning for warning in built.warnings if "jumps" in warning]
    first = expected.rows[0]
    given = Options(annotated={first.file: tuple(mark + 3 / 60 * (k > 0) for k, mark in enumerate(first.marks))})
    assert propose(posed, given).rows[0].marks == pytest.approx(proposal.rows[0].marks, abs=1e-4)
