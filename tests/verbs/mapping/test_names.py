"""Bones by the names of joints, in the conventions of many rigs."""

import pytest

from verbs.mapping.names import label, roles_of
from verbs.mapping.presets import PRESETS, preset

SIDED = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toes")

CONVENTIONS = {
    "built-in": (
        "Hips, Spine, Spine1, Neck, Head",
        "LeftShoulder, LeftArm, LeftForeArm, LeftHand",
        "LeftUpLeg, LeftLeg, LeftFoot, LeftToeBase",
    ),
    "mixamo": (
        "mixamorig:Hips, mixamorig:Spine, mixamorig:Neck, mixamorig:Head",
        "mixamorig:LeftShoulder, mixamorig:LeftArm, mixamorig:LeftForeArm, mixamorig:LeftHand",
        "mixamorig:LeftUpLeg, mixamorig:LeftLeg, mixamorig:LeftFoot, mixamorig:LeftToeBase",
    ),
    "mixamo without colon": (
        "mixamorigHips, mixamorigSpine, mixamorigNeck, mixamorigHead",
        "mixamorigLeftShoulder, mixamorigLeftArm, mixamorigLeftForeArm, mixamorigLeftHand",
        "mixamorigLeftUpLeg, mixamorigLeftLeg, mixamorigLeftFoot, mixamorigLeftToeBase",
    ),
    "unreal": (
        "pelvis, spine_01, spine_02, neck_01, head",
        "clavicle_l, upperarm_l, lowerarm_l, hand_l",
        "thigh_l, calf_l, foot_l, ball_l",
    ),
    "unity": (
        "Hips, Spine, Chest, Neck, Head",
        "LeftShoulder, LeftUpperArm, LeftLowerArm, LeftHand",
        "LeftUpperLeg, LeftLowerLeg, LeftFoot, LeftToes",
    ),
    "vroid": (
        "J_Bip_C_Hips, J_Bip_C_Spine, J_Bip_C_Neck, J_Bip_C_Head",
        "J_Bip_L_Shoulder, J_Bip_L_UpperArm, J_Bip_L_LowerArm, J_Bip_L_Hand",
        "J_Bip_L_UpperLeg, J_Bip_L_LowerLeg, J_Bip_L_Foot, J_Bip_L_ToeBase",
    ),
    "smpl": (
        "pelvis, spine1, spine2, neck, head",
        "left_collar, left_shoulder, left_elbow, left_wrist",
        "left_hip, left_knee, left_ankle, left_foot",
    ),
    "old captures": (
        "Hips, Chest, Neck, Head",
        "LeftCollar, LeftShoulder, LeftElbow, LeftWrist",
        "LeftHip, LeftKnee, LeftAnkle, LeftToe",
    ),
    "biped": (
        "Bip01 Pelvis, Bip01 Spine, Bip01 Neck, Bip01 Head",
        "Bip01 L Clavicle, Bip01 L UpperArm, Bip01 L Forearm, Bip01 L Hand",
        "Bip01 L Thigh, Bip01 L Calf, Bip01 L Foot, Bip01 L Toe0",
    ),
    "source engine": (
        "ValveBiped.Bip01_Pelvis, ValveBiped.Bip01_Spine, ValveBiped.Bip01_Neck1, ValveBiped.Bip01_Head1x",
        "ValveBiped.Bip01_L_Clavicle, ValveBiped.Bip01_L_UpperArm, ValveBiped.Bip01_L_Forearm, ValveBiped.Bip01_L_Hand",
        "ValveBiped.Bip01_L_Thigh, ValveBiped.Bip01_L_Calf, ValveBiped.Bip01_L_Foot, ValveBiped.Bip01_L_Toe0",
    ),
    "blender": (
        "hips, spine, chest, neck, head",
        "shoulder.L, upper_arm.L, forearm.L, hand.L",
        "thigh.L, shin.L, foot.L, toe.L",
    ),
    "daz": (
        "pelvis, abdomenLower, neckLower, head",
        "lCollar, lShldrBend, lForearmBend, lHand",
        "lThighBend, lShin, lFoot, lToe",
    ),
    "character creator": (
        "CC_Base_Hip, CC_Base_Waist, CC_Base_NeckTwist01x, CC_Base_Head",
        "CC_Base_L_Clavicle, CC_Base_L_Upperarm, CC_Base_L_Forearm, CC_Base_L_Hand",
        "CC_Base_L_Thigh, CC_Base_L_Calf, CC_Base_L_Foot, CC_Base_L_ToeBase",
    ),
    "lower case": (
        "hips, spine, neck, head",
        "leftshoulder, leftarm, leftforearm, lefthand",
        "leftupleg, leftleg, leftfoot, lefttoebase",
    ),
    "suffix": (
        "Hips, Spine, Neck, Head",
        "Shoulder_L, UpperArm_L, LowerArm_L, Hand_L",
        "UpperLeg_L, LowerLeg_L, Foot_L, Toes_L",
    ),
    "motive": (
        "Hip, Ab, Chest, Neck, Head",
        "LShoulder, LUArm, LFArm, LHand",
        "LThigh, LShin, LFoot, LToe",
    ),
    "namespace": (
        "char:rig:Hips, char:rig:Spine, char:rig:Neck, char:rig:Head",
        "char:rig:LeftShoulder, char:rig:LeftArm, char:rig:LeftForeArm, char:rig:LeftHand",
        "char:rig:LeftUpLeg, char:rig:LeftLeg, char:rig:LeftFoot, char:rig:LeftToeBase",
    ),
}  # fmt: skip
"""Hips, spine, neck and head; the left arm; the left leg."""


def other_side(name: str) -> str:
    """The name of the right side's joint."""
    for left, right in (
        ("Left", "Right"),
        ("left", "right"),
        ("_L_", "_R_"),
        (" L ", " R "),
        (".L", ".R"),
        ("_l", "_r"),
    ):
        if left in name and not (left == "_l" and not name.endswith("_l")):
            return name.replace(left, right)
    if name.endswith("_L"):
        return name[:-1] + "R"
    assert name[0] in "lL", name
    return {"l": "r", "L": "R"}[name[0]] + name[1:]


def hierarchy(trunk: str, arm: str, leg: str) -> tuple[list[str], list[int]]:
    names = trunk.split(", ")
    parents = list(range(-1, len(names) - 1))
    chest = len(names) - 3
    left = [*arm.split(", "), *leg.split(", ")]
    for side in (left, [other_side(name) for name in left]):
        for k, name in enumerate(side):
            parents.append(chest if k == 0 else 0 if k == 4 else len(names) - 1)
            names.append(name)
    return names, parents


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_bones_of_a_convention(convention: str) -> None:
    names, parents = hierarchy(*CONVENTIONS[convention])
    roles = roles_of(names, parents)
    for bone, name in zip(SIDED, names[-16:-8], strict=True):
        assert names[roles.bones[f"left{bone}"]] == name
        assert names[roles.bones[f"right{bone}"]] == other_side(name)
    assert names[roles.bones["hips"]] == names[0]
    assert [names[joint] for joint in roles.spine] == names[1:-18]


def test_helpers_are_no_bones() -> None:
    for name in (
        "upperarm_twist_01_l",
        "ik_foot_l",
        "LeftToe_End",
        "HeadTop_End",
        "LeftForeArmRoll",
        "hair_01",
        "Eye.L",
    ):
        assert label(name) == ("", ""), name


def test_unknown_names_make_no_humanoid() -> None:
    assert not roles_of(["Bone", "Bone.001", "Bone.002"], [-1, 0, 1])


def test_bones_that_a_file_names_win() -> None:
    names, parents = hierarchy(*CONVENTIONS["unity"])
    names = [f"node {k}" for k in range(len(names))]
    full = roles_of(*hierarchy(*CONVENTIONS["unity"]))
    roles = roles_of(names, parents, full.bones)
    assert roles == full


def test_a_joint_that_is_given_is_no_other_bone() -> None:
    names, parents = hierarchy(*CONVENTIONS["unity"])
    found = roles_of(names, parents, {"leftUpperArm": names.index("RightUpperArm")}).bones
    assert found["leftUpperArm"] == names.index("RightUpperArm")
    assert "rightUpperArm" not in found


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_humanoids(name: str) -> None:
    rig = preset(name)
    for side in ("left", "right"):
        assert {f"{side}{bone}" for bone in SIDED} <= set(rig.roles.bones)
    assert len(rig.roles.spine) == 3
    assert {"hips", "head"} <= set(rig.roles.bones)
