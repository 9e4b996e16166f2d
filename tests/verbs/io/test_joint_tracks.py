"""BVH files in which joints other than the root move: folded, fixed or refused."""

from __future__ import annotations

import numpy as np
import pytest

from tests.verbs import clip_files
from tests.verbs.clip_files import Bone, moving
from tests.verbs.io.test_bvh_oracles import by_pymotion
from verbs.errors import MotionFileError
from verbs.io import bvh
from verbs.io.report import MotionFile
from verbs.kernels import fk, quat

FRAMES = 20


def positions(file: MotionFile) -> dict[str, np.ndarray]:
    motion = file.motion
    found = fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]
    return {name: found[:, k] for k, name in enumerate(motion.skeleton.names)}


def assert_places(file: MotionFile, bones, atol: float = 1e-8) -> None:
    """Every joint of the motion is where the bone of its name is."""
    expected = clip_files.global_positions(bones)
    for name, found in positions(file).items():
        np.testing.assert_allclose(found, expected[name], atol=atol, err_msg=name)


def named(bones, name) -> Bone:
    return next(bone for bone in bones if bone.name == name)


def stretched(bones, name: str, metres: float) -> None:
    """Give a bone position channels that swing about its offset by ``metres`` along its own direction."""
    bone = named(bones, name)
    track = np.tile(bone.offset, (FRAMES, 1))
    track += metres * np.sin(np.arange(FRAMES))[:, None] * np.asarray(bone.offset) / np.linalg.norm(bone.offset)
    bone.channels = {f"{axis}position": track[:, k] for k, axis in enumerate("XYZ")} | bone.channels


# --- folding ----------------------------------------------------------------------------------------------


def test_hips_that_move_under_a_ground_root_become_the_root(tmp_path):
    bones = clip_files.on_the_ground(clip_files.body_bones(), clip_files.ground())
    path = clip_files.write_bvh(tmp_path / "walk.bvh", bones)
    file = bvh.read_file(path)
    assert file.motion.skeleton.names == tuple(name for name, _, _ in clip_files.BODY)
    assert_places(file, bones)
    oracle = by_pymotion(path)
    np.testing.assert_allclose(np.stack(list(positions(file).values()), axis=1), oracle[:, 1:], atol=1e-6)
    (note,) = file.report.of("folded")
    assert note.text == "joint 'Reference' is folded into 'Hips', the new root"
    assert file.report.changes == (note.text,)
    assert len(file.motion.skeleton.tip_parents) == len(clip_files.TIPS)


def test_the_motion_of_the_folded_joint_stays_available(tmp_path):
    ground = clip_files.ground()
    path = clip_files.write_bvh(tmp_path / "walk.bvh", clip_files.on_the_ground(clip_files.body_bones(), ground))
    (folded,) = bvh.read_file(path).report.folded
    assert folded.name == "Reference"
    np.testing.assert_allclose(folded.positions, np.stack(list(ground.channels.values())[:3], -1), atol=1e-8)
    np.testing.assert_allclose(quat.log(folded.rotations)[:, 1], np.radians(np.linspace(0, 70, FRAMES)), atol=1e-8)


def test_a_chain_of_joints_above_the_hips_is_folded_in_order(tmp_path):
    still = Bone("Armature", -1, (0.1, 0.2, 0.3), moving("XYZ", np.tile([90.0, 0.0, 10.0], (FRAMES, 1))))
    bones = clip_files.on_the_ground(clip_files.body_bones(), still, clip_files.ground(name="root"))
    file = bvh.read_file(clip_files.write_bvh(tmp_path / "walk.bvh", bones))
    assert [folded.name for folded in file.report.folded] == ["Armature", "root"]
    assert_places(file, bones)
    np.testing.assert_allclose(file.report.folded[1].positions, clip_files.global_positions(bones)["root"], atol=1e-8)


def test_small_targets_beside_the_hips_are_left_out(tmp_path):
    bones = clip_files.on_the_ground(clip_files.body_bones(), clip_files.ground())
    for k, name in enumerate(("ik_foot_l", "ik_foot_r")):
        track = np.linspace([0, 0, 0], [k, 1, 1], FRAMES)
        bones.append(Bone(name, 0, (0, 0, 0), moving("XYZ", np.zeros((FRAMES, 3)), track)))
    file = bvh.read_file(clip_files.write_bvh(tmp_path / "walk.bvh", bones))
    assert "ik_foot_l" not in file.motion.skeleton.names
    assert_places(file, bones)
    (note,) = file.report.of("left_out")
    assert note.amount == 2.0
    assert "'ik_foot_l', 'ik_foot_r'" in note.text


def test_a_spine_that_moves_beside_the_legs_is_not_folded(tmp_path):
    bones = clip_files.body_bones()
    stretched(bones, "Spine", 0.04)
    path = clip_files.write_bvh(tmp_path / "walk.bvh", bones)
    with pytest.raises(MotionFileError) as caught:
        bvh.read(path)
    assert caught.value.line == path.read_text().splitlines().index("JOINT Spine") + 1
    assert caught.value.found.startswith("8 joints beside it on 'Hips': 'LeftUpLeg'")
    assert "'Spine'" in caught.value.advice


def test_a_chain_without_branches_is_never_folded():
    bones = [Bone(f"j{k}", k - 1, (0, 0.3, 0), moving("ZXY", np.zeros((FRAMES, 3)))) for k in range(4)]
    stretched(bones, "j1", 0.03)
    with pytest.raises(MotionFileError, match="joint 'j1' within 5 mm of its mean offset"):
        bvh.parse(clip_files.bvh_text(bones))


def test_a_root_that_is_named_is_folded_although_it_stays(tmp_path):
    hips = clip_files.body_bones()
    hips[0].channels = {name: track for name, track in hips[0].channels.items() if name.endswith("rotation")}
    hips[0].offset = (0.0, 0.9, 0.0)
    bones = clip_files.on_the_ground(hips, clip_files.ground())
    path = clip_files.write_bvh(tmp_path / "still.bvh", bones)
    assert bvh.read(path).skeleton.names[0] == "Reference"
    file = bvh.read_file(path, root="Hips")
    assert file.motion.skeleton.names[0] == "Hips"
    assert_places(file, bones)
    with pytest.raises(MotionFileError, match="a joint 'Pelvis' that becomes the root, found Reference, Hips, "):
        bvh.read(path, root="Pelvis")


# --- offsets and stretch ----------------------------------------------------------------------------------


def test_constant_positions_become_the_offset_and_are_reported():
    bones = clip_files.body_bones()
    head = named(bones, "Head")
    head.channels = moving("XYZ", np.zeros((FRAMES, 3)), np.tile([0.0, 0.31, 0.02], (FRAMES, 1)))
    file = bvh.parse_file(clip_files.bvh_text(bones))
    (note,) = file.report.of("offset")
    assert note.subject == "Head"
    assert file.report.changes == ()
    assert_places(file, bones)


def test_a_small_stretch_is_dropped_and_reported_in_millimetres():
    bones = clip_files.body_bones()
    stretched(bones, "LeftHand", 0.002)
    file = bvh.parse_file(clip_files.bvh_text(bones))
    (note,) = file.report.of("stretch")
    assert note.subject == "LeftHand"
    assert note.amount == pytest.approx(0.002, abs=2e-4)
    assert "stretches by up to 2.0" in note.text
    assert_places(file, bones, atol=2.2e-3)


def test_rounding_is_no_stretch():
    bones = clip_files.body_bones()
    stretched(bones, "LeftHand", 0.00005)
    report = bvh.parse_file(clip_files.bvh_text(bones)).report
    assert (report.of("stretch"), report.changes) == ((), ())
    assert [note.subject for note in report.of("offset")] == ["LeftHand"]


def test_a_large_stretch_is_refused_by_name_unless_allowed():
    bones = clip_files.body_bones()
    stretched(bones, "LeftHand", 0.02)
    text = clip_files.bvh_text(bones)
    with pytest.raises(MotionFileError) as caught:
        bvh.parse(text)
    assert caught.value.line == text.splitlines().index("JOINT LeftHand") + 1
    assert caught.value.expected == "joint 'LeftHand' within 5 mm of its mean offset (stretch_m)"
    assert caught.value.found.startswith("20.") or caught.value.found.startswith("19.")
    assert "allow more with stretch_m" in caught.value.advice
    assert bvh.parse(text, stretch_m=0.03).skeleton.names[0] == "Hips"


# --- several roots, tips with channels, unusual sizes ------------------------------------------------------


def sword(frames: int = FRAMES) -> list[Bone]:
    track = np.linspace([0, 0, 0], [1, 1, 1], frames)
    blade = Bone("Blade", 0, (0, 0.5, 0), moving("XYZ", np.zeros((frames, 3))))
    return [Bone("Sword", -1, (0, 0, 0), moving("XYZ", np.zeros((frames, 3)), track)), blade]


@pytest.mark.parametrize("first", [True, False])
def test_of_several_roots_the_one_with_the_most_joints_is_read(first):
    bones, prop = clip_files.body_bones(), sword()
    both, shift = ([*prop, *bones], 2) if first else ([*bones, *prop], len(bones))
    for bone in both[shift:]:
        bone.parent += shift if bone.parent >= 0 else 0
    file = bvh.parse_file(clip_files.bvh_text(both))
    assert_places(file, both)
    assert file.motion.skeleton.names[0] == "Hips"
    (note,) = file.report.of("ignored_root")
    assert note.text == "hierarchy 'Sword' with 2 joints is ignored; 'Hips' is read"
    assert bvh.parse(clip_files.bvh_text(both), root="Sword").skeleton.names == ("Sword", "Blade")


def test_two_characters_of_one_size_need_a_choice():
    first, second = clip_files.body_bones(), clip_files.body_bones(seed=1)
    for bone in second:
        bone.name, bone.parent = f"B_{bone.name}", bone.parent + len(first) if bone.parent >= 0 else -1
    text = clip_files.bvh_text([*first, *second])
    with pytest.raises(MotionFileError, match="found 2 hierarchies with 18 joints: Hips, B_Hips; name the root"):
        bvh.parse(text)
    assert bvh.parse(text, root="B_Hips").skeleton.names[0] == "B_Hips"


def test_one_name_may_stand_in_two_hierarchies():
    bones, prop = clip_files.body_bones(), sword()
    prop[1].name, prop[1].parent = "Head", len(bones)
    file = bvh.parse_file(clip_files.bvh_text([*bones, *prop]))
    assert_places(file, bones)


def test_channels_of_an_end_site_are_skipped_and_reported():
    bones = clip_files.body_bones()
    named(bones, "Head").tip_channels = moving("XYZ", np.full((FRAMES, 3), 12.0), np.full((FRAMES, 3), 3.0))
    file = bvh.parse_file(clip_files.bvh_text(bones))
    assert_places(file, bones)
    assert [note.subject for note in file.report.of("ignored_channels")] == ["Head"]


def test_joints_with_positions_alone_do_not_turn():
    bones = clip_files.body_bones()
    named(bones, "Head").channels = {"Yposition": np.full(FRAMES, 0.25)}
    assert_places(bvh.parse_file(clip_files.bvh_text(bones)), bones)


@pytest.mark.parametrize("frames", [1, 2])
def test_single_frames_are_motions(frames):
    bones = clip_files.on_the_ground(clip_files.body_bones(frames), clip_files.ground(frames))
    motion = bvh.parse(clip_files.bvh_text(bones), root="Hips")
    assert len(motion) == frames


def test_a_joint_of_no_length_is_read():
    bones = clip_files.body_bones()
    named(bones, "Spine").offset = (0.0, 0.0, 0.0)
    assert_places(bvh.parse_file(clip_files.bvh_text(bones)), bones)


def test_a_hundred_thousand_frames_are_read():
    bones = [Bone("a", -1, (0, 1, 0), {"Xrotation": np.arange(100_000) % 360.0})]
    motion = bvh.parse(clip_files.bvh_text(bones, 120.0))
    assert (len(motion), motion.fps) == (100_000, 120.0)
    np.testing.assert_allclose(motion.rotations[90, 0], quat.exp([np.pi / 2, 0, 0]), atol=1e-12)


def test_a_long_chain_above_the_body_is_refused():
    above = [Bone(f"a{k}", -1, (0, 0.1, 0), moving("X", np.zeros((FRAMES, 1)))) for k in range(40)]
    bones = clip_files.on_the_ground(clip_files.body_bones(), *above)
    with pytest.raises(MotionFileError, match="at most 32 joints above the body, found 'a32' below as many"):
        bvh.parse(clip_files.bvh_text(bones))


def test_a_damaged_rig_gives_a_motion_or_a_motion_file_error():
    bones = clip_files.on_the_ground(clip_files.body_bones(3), clip_files.ground(3))
    named(bones, "Head").tip_channels = moving("XYZ", np.zeros((3, 3)))
    prop = sword(3)
    for bone in prop:
        bone.parent += len(bones) if bone.parent >= 0 else 0
    text = clip_files.bvh_text([*bones, *prop])
    lines, rng, refused = text.splitlines(), np.random.default_rng(0), 0
    words = [
        "ROOT x",
        "}",
        "{",
        "End Site",
        "CHANNELS 0",
        "CHANNELS 3 Xposition Yposition Zposition",
        "OFFSET 0 0 0",
        "0",
    ]
    for _ in range(600):
        damaged = list(lines)
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(len(damaged)))
            change = int(rng.integers(4))
            if change == 0:
                del damaged[at]
            elif change == 1:
                damaged.insert(at, str(rng.choice(words)))
            elif change == 2:
                damaged[at] = damaged[at].replace("position", "rotation", 1)
            else:
                damaged.insert(at, damaged[int(rng.integers(len(damaged)))])
        try:
            bvh.parse("\n".join(damaged), stretch_m=float(rng.choice([0.0, 0.005, 10.0])))
        except MotionFileError:
            refused += 1
    assert 200 < refused < 600
