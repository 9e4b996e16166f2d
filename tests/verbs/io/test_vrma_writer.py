"""VRM animations: the map of bones, the T-pose at rest, and what is missing where a skeleton is no humanoid."""

import numpy as np
import pytest

from tests.verbs.gltf_files import random_rotations
from tests.verbs.io.test_gltf_writer import motion_of, table_of
from verbs.errors import RequestError
from verbs.io import gltf, humanoid, vrma_writer
from verbs.kernels import fk, quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton


def posed(motion, turned):
    """The motion of the same figure whose rest pose is turned: other offsets and rotations, equal positions."""
    skeleton = motion.skeleton
    parents = skeleton.parents[1:]
    offsets = skeleton.offsets.copy()
    offsets[1:] = quat.rotate(turned[parents], offsets[1:])
    tips = quat.rotate(turned[skeleton.tip_parents], skeleton.tip_offsets)
    own = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.tip_parents, tips)
    rotations = quat.mul(motion.rotations, quat.conjugate(turned))
    rotations[:, 1:] = quat.mul(turned[parents], rotations[:, 1:])
    return Motion(own, motion.fps, motion.root, rotations)


def arms_down(skeleton):
    """Global rotations of a rest pose whose arms hang, whose legs are apart, and whose feet are flat on the ground."""
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (len(skeleton), 1))
    for name, angle in (("LeftArm", -1.3), ("RightArm", 1.3), ("LeftUpLeg", 0.2), ("RightUpLeg", -0.2)):
        turn = quat.exp(np.array([0.0, 0.0, angle]))
        for joint in range(len(skeleton)):
            above = skeleton.chain(joint)
            feet = {skeleton.index("LeftFoot"), skeleton.index("RightFoot")}
            if skeleton.index(name) in above and not feet & set(above):
                turned[joint] = turn
    return turned


def positions(motion):
    return fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]


def table_and_motion(motion, folder):
    content = vrma_writer.dump(motion)
    (folder / "a.glb").write_bytes(content)
    return table_of(content), gltf.read_file(folder / "a.glb").motion


def test_bones_are_mapped_by_name(tmp_path):
    table, _ = table_and_motion(motion_of("reach"), tmp_path)
    extension = table["extensions"]["VRMC_vrm_animation"]
    assert (extension["specVersion"], table["extensionsUsed"]) == ("1.0", ["VRMC_vrm_animation"])
    names = {bone: table["nodes"][row["node"]]["name"] for bone, row in extension["humanoid"]["humanBones"].items()}
    assert set(humanoid.REQUIRED) <= set(names)
    expected = {"hips": "Hips", "upperChest": "Spine2", "leftUpperArm": "LeftArm", "rightLowerLeg": "RightLeg"}
    assert expected.items() <= names.items()
    assert names["leftThumbMetacarpal"] == "LeftHandThumb1"
    assert len(names) == len(table["nodes"]) == len(set(names.values()))


@pytest.mark.parametrize("prefix", ["", "mixamorig:"])
def test_prefixes_and_vrm_names_are_known(prefix):
    names = tuple(prefix + name for name in ("Hips", "spine", "LEFT_ARM", "leftLowerArm", "Left Hand"))
    skeleton = Skeleton(names, np.arange(5) - 1, np.zeros((5, 3)))
    assert humanoid.bones_of(skeleton) == {"hips": 0, "spine": 1, "leftUpperArm": 2, "leftLowerArm": 3, "leftHand": 4}


def test_positions_of_the_bones_are_kept(tmp_path):
    motion = motion_of("reach")
    _, found = table_and_motion(motion, tmp_path)
    expected = dict(zip(motion.skeleton.names, positions(motion).swapaxes(0, 1), strict=True))
    for name, places in zip(found.skeleton.names, positions(found).swapaxes(0, 1), strict=True):
        np.testing.assert_allclose(places, expected[name], atol=1e-5, err_msg=name)


def test_nodes_rest_in_a_t_pose_on_the_ground(tmp_path):
    motion = motion_of("reach")
    table, _ = table_and_motion(posed(motion, arms_down(motion.skeleton)), tmp_path)
    places, turns, rows = {}, {}, table["nodes"]
    waiting = [(0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))]
    while waiting:
        node, place, turn = waiting.pop()
        place = place + quat.rotate(turn, np.array(rows[node]["translation"]))
        turn = quat.mul(turn, np.array(rows[node]["rotation"]))
        places[rows[node]["name"]], turns[rows[node]["name"]] = place, turn
        waiting += [(child, place, turn) for child in rows[node].get("children", ())]
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        for upper, lower in (("Arm", "ForeArm"), ("ForeArm", "Hand")):
            along = places[f"{side}{lower}"] - places[f"{side}{upper}"]
            np.testing.assert_allclose(along / np.linalg.norm(along), [sign, 0.0, 0.0], atol=1e-6)
        for upper, lower in (("UpLeg", "Leg"), ("Leg", "Foot")):
            along = places[f"{side}{lower}"] - places[f"{side}{upper}"]
            np.testing.assert_allclose(along / np.linalg.norm(along), [0.0, -1.0, 0.0], atol=1e-6)
        toes = places[f"{side}ToeBase"] - places[f"{side}Foot"]
        assert toes[2] > 0.1
        assert abs(toes[0]) < 1e-6
        assert -1e-9 < places[f"{side}ToeBase"][1] < 0.05


def test_the_rest_pose_of_a_skeleton_does_not_matter(tmp_path):
    """The same motion on a skeleton that rests with hanging arms gives the same rotations relative to the T-pose."""
    motion = motion_of("reach")
    other = posed(motion, arms_down(motion.skeleton))
    np.testing.assert_allclose(positions(other), positions(motion), atol=1e-9)
    normalized = []
    for source in (motion, other):
        table, found = table_and_motion(source, tmp_path)
        rest = np.array([row["rotation"] for row in table["nodes"]])
        order = [row["name"] for row in table["nodes"]]
        local = found.rotations[:, [found.skeleton.index(name) for name in order]]
        parents = {child: k for k, row in enumerate(table["nodes"]) for child in row.get("children", ())}
        whole = np.empty_like(rest)
        for k in range(len(rest)):
            whole[k] = quat.mul(whole[parents[k]], rest[k]) if k else rest[k]
        above = np.stack([whole[parents[k]] if k else np.array([0.0, 0.0, 0.0, 1.0]) for k in range(len(rest))])
        normalized.append(quat.mul(quat.mul(above, local), quat.conjugate(whole)))
    first, second = normalized
    np.testing.assert_allclose(np.abs((first * second).sum(axis=-1)), 1.0, atol=1e-5)


def test_a_joint_between_two_bones_is_not_lost(tmp_path):
    """A second neck joint is no bone; the head keeps its global rotation."""
    motion = motion_of("reach")
    skeleton = motion.skeleton
    neck = skeleton.index("Neck")
    parents = np.where(skeleton.parents > neck, skeleton.parents + 1, skeleton.parents)
    parents = np.insert(parents, neck + 1, neck)
    parents[neck + 2] = neck + 1
    names = (*skeleton.names[: neck + 1], "Neck1", *skeleton.names[neck + 1 :])
    offsets = np.insert(skeleton.offsets, neck + 1, [0.0, 0.02, 0.0], axis=0)
    extra = random_rotations(np.random.default_rng(3), len(motion))
    rotations = np.insert(motion.rotations, neck + 1, extra, axis=1)
    longer = Motion(Skeleton(names, parents, offsets), motion.fps, motion.root, rotations)
    _, found = table_and_motion(longer, tmp_path)
    assert "Neck1" not in found.skeleton.names
    own = found.skeleton
    turns = fk.forward(found.root, found.rotations, own.parents, own.offsets)[0][:, own.index("Head")]
    expected = fk.forward(longer.root, longer.rotations, parents, offsets)[0][:, neck + 2]
    np.testing.assert_allclose(np.abs((turns * expected).sum(axis=-1)), 1.0, atol=1e-6)


def test_a_skeleton_that_is_no_humanoid_is_refused_with_the_bones_it_lacks():
    with pytest.raises(RequestError, match=r"no joint for hips \(Hips\), spine \(Spine\).*rightFoot \(RightFoot\)"):
        vrma_writer.dump(motion_of("arm3"))
    walker = motion_of("walk").skeleton
    assert "hips (Hips)" in humanoid.missing(humanoid.bones_of(walker))
