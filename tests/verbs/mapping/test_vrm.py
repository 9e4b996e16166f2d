"""VRM animations on targets whose names are not those of VRM."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.verbs.io.test_gltf_writer import table_of
from tests.verbs.mapping.rigs import remade, with_spine
from verbs import library
from verbs.io import gltf, motion_files
from verbs.io.humanoid import REQUIRED
from verbs.kernels import fk, quat
from verbs.mapping.mapper import Mapper
from verbs.mapping.mapping import Mapping
from verbs.mapping.presets import preset
from verbs.mapping.rig import Rig
from verbs.mapping.vrm import humanoid_of
from verbs.runtime import sequence
from verbs.runtime.evaluate import Evaluator


def vroid() -> Rig:
    rig = preset("vrm")
    names = tuple(f"J_Bip_C_{name[0].upper()}{name[1:]}" for name in rig.skeleton.names)
    names = tuple(name.replace("C_Left", "L_").replace("C_Right", "R_") for name in names)
    return replace(rig, skeleton=replace(rig.skeleton, names=names))


TARGETS: dict[str, Callable[[], Rig]] = {
    "unreal": lambda: preset("unreal"),
    "smpl": lambda: preset("smpl"),
    "vroid": vroid,
    "A-pose and other axes": lambda: remade(preset("unreal"), roll=3, lowered=0.8),
    "five spine joints": lambda: with_spine(preset("mixamo"), 5),
}


@pytest.mark.parametrize("target", TARGETS)
def test_a_vrm_animation_of_any_humanoid_target(target: str, tmp_path: Path) -> None:
    evaluator = Evaluator(library.load("reach"))
    mapper = Mapper.of_verb(evaluator, Mapping(TARGETS[target]()))
    motion, _ = mapper.sequence(evaluator, sequence.sequence(evaluator, evaluator.verb.values[:1], 30.0), 30.0)
    human = humanoid_of(mapper.mapping.rig)
    content = motion_files.dump(motion, "vrma", humanoid=human)
    table = table_of(content)
    rows, bones = table["nodes"], table["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
    assert set(REQUIRED) | {"chest", "upperChest"} <= set(bones)
    (tmp_path / "a.glb").write_bytes(content)
    found = gltf.read_file(tmp_path / "a.glb").motion
    ours = fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]
    own = found.skeleton
    theirs = fk.forward(found.root, found.rotations, own.parents, own.offsets)[1]
    near = 0.03 if target == "five spine joints" else 1e-5  # two of them are no bones, and bend at the next one
    for bone, row in bones.items():
        node = own.names.index(rows[row["node"]]["name"])
        np.testing.assert_allclose(theirs[:, node], ours[:, human.bones[bone]], atol=near, err_msg=bone)
    places = at_rest(rows)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for upper, lower, wanted in (
            ("UpperArm", "LowerArm", [sign, 0, 0]), ("LowerArm", "Hand", [sign, 0, 0]),
            ("UpperLeg", "LowerLeg", [0, -1, 0]), ("LowerLeg", "Foot", [0, -1, 0]),
        ):  # fmt: skip
            along = places[bones[side + lower]["node"]] - places[bones[side + upper]["node"]]
            np.testing.assert_allclose(along / np.linalg.norm(along), wanted, atol=1e-6)
    up = places[bones["head"]["node"]] - places[bones["hips"]["node"]]
    assert up[1] > 0.95 * np.linalg.norm(up)
    assert 0.0 < min(place[1] for place in places.values()) + 1e-6 < 0.1


def at_rest(rows: list[dict[str, list[float]]]) -> dict[int, np.ndarray]:
    """Global positions (3,) of nodes at rest."""
    places: dict[int, np.ndarray] = {}
    waiting = [(0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))]
    while waiting:
        node, place, turn = waiting.pop()
        places[node] = place + quat.rotate(turn, np.array(rows[node]["translation"]))
        turn = quat.mul(turn, np.array(rows[node]["rotation"]))
        waiting += [(int(child), places[node], turn) for child in rows[node].get("children", ())]
    return places
