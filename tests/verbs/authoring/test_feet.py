import numpy as np
import pytest

from tests.verbs import walker
from verbs.authoring import contact_detection
from verbs.authoring.fit import build
from verbs.clips import feet
from verbs.contacts import PARTS
from verbs.kernels import fk
from verbs.skeleton import Skeleton


def found(motion):
    rotations, positions = fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)
    return feet.feet(motion.skeleton, rotations, positions)


def named(motion):
    names = motion.skeleton.names
    return [(names[p.foot], PARTS[p.part], names[p.joint]) for foot in found(motion) for p in foot]


def test_the_toe_joint_is_the_ball_and_its_tip_the_toe():
    assert named(walker.stand(0.5)) == [
        (f"{side}Foot", part, f"{side}ToeBase") for side in ("Left", "Right") for part in ("ball", "toe")
    ]


@pytest.mark.parametrize(
    ("leg", "foot"),
    [
        (("UpLeg", "Leg", "Foot", "ToeBase"), "Foot"),
        (("_thigh", "_calf", "_foot", "_ball"), "_foot"),
        (("Femur", "Tibia", "Ankle", "Toes"), "Ankle"),
        (("a", "b", "c", "d"), "c"),
    ],
)
def test_feet_are_found_with_the_names_of_other_programs_and_without(leg, foot):
    names = ("Root", "Trunk", "Top", *(side + part for side in "lr" for part in leg))
    points = found(walker.stand(0.5, body=walker.skeleton(names)))
    assert [names[p.foot] for one in points for p in one] == ["l" + foot, "l" + foot, "r" + foot, "r" + foot]


def test_a_foot_without_a_toe_joint_has_one_point():
    points = named(walker.stand(0.5, body=walker.skeleton(toes=False)))
    assert points == [("LeftFoot", "foot", "LeftFoot"), ("RightFoot", "foot", "RightFoot")]


def test_a_joint_that_marks_the_end_of_the_toes_is_the_toe():
    body = walker.skeleton()
    names = [*body.names[:7], "LeftToe_End", *body.names[7:], "RightToe_End"]
    parents = [*body.parents[:7], 6, 0, *(body.parents[8:] + 1), 11]
    offsets = np.concatenate([body.offsets[:7], [[0, 0, 0.07]], body.offsets[7:], [[0, 0, 0.07]]])
    longer = Skeleton(tuple(names), np.array(parents), offsets)
    rest = np.zeros((3, len(longer), 4))
    rest[..., 3] = 1.0
    rotations, positions = fk.forward(np.tile([0, 0.9, 0], (3, 1)), rest, longer.parents, longer.offsets)
    (_, toe), _ = feet.feet(longer, rotations, positions)
    assert (longer.names[toe.foot], longer.names[toe.joint]) == ("LeftFoot", "LeftToe_End")


def quadruped() -> Skeleton:
    """Four legs of three joints on a trunk, a tail and a head."""
    names, parents, offsets = ["trunk", "front", "head", "tail"], [-1, 0, 1, 0], [[0, 0, 0], [0, 0, 0.8], [0, 0.2, 0.3],
                                                                                 [0, 0, -0.4]]  # fmt: skip
    for base in (0, 1):
        for sign in (1, -1):
            first = len(names)
            names += [f"leg{first}{part}" for part in ("a", "b", "c")]
            parents += [base, first, first + 1]
            offsets += [[0.2 * sign, 0, 0], [0, -0.3, 0], [0, -0.3, 0.02]]
    return Skeleton(tuple(names), np.array(parents), np.array(offsets, float))


def test_four_legs_have_four_feet():
    body = quadruped()
    rest = np.zeros((5, len(body), 4))
    rest[..., 3] = 1.0
    rotations, positions = fk.forward(np.tile([0, 0.6, 0], (5, 1)), rest, body.parents, body.offsets)
    points = feet.feet(body, rotations, positions)
    assert [body.names[foot[0].foot] for foot in points] == [f"leg{k}c" for k in (4, 7, 10, 13)]
    assert all(PARTS[foot[0].part] == "foot" and len(foot) == 1 for foot in points)


def test_a_foot_that_stands_on_its_toes_has_no_heel(tmp_path):
    steep = walker.skeleton()
    offsets = steep.offsets.copy()
    offsets[[6, 10]] = [0.0, -0.2, 0.05]
    body = Skeleton(steep.names, steep.parents, offsets, steep.tip_parents, steep.tip_offsets)
    verb = build(walker.source(tmp_path / "toes", {"a": walker.stand(body=body), "b": walker.stand(body=body)})).verb
    assert [PARTS[part] for part in verb.contacts.parts] == ["ball", "toe", "ball", "toe"]
    assert np.arctan2(0.2, 0.05) > contact_detection.SLOPE_RAD


def test_hands_that_touch_the_ground_for_a_moment_are_no_feet(mocap, verb_of):
    verb = verb_of("reach")
    names = {verb.skeleton.names[foot] for foot in verb.contacts.feet}
    assert names == {"LeftFoot", "RightFoot"}
