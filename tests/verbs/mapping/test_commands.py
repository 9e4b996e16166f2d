"""``adverb map`` and ``adverb export --map``."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from tests.strangers.vrm_files import avatar
from tests.verbs.mapping.parted import glb, split
from verbs import library
from verbs.cli import app
from verbs.errors import RequestError, UnknownName
from verbs.io import gltf, gltf_writer, motion_files
from verbs.io.gltf_accessors import Accessors
from verbs.io.gltf_document import open_document
from verbs.kernels import fk
from verbs.mapping.mapping import open_mapping
from verbs.mapping.presets import PRESETS, preset
from verbs.mapping.reading import TARGETS, read_rig
from verbs.motion import Motion

AT = ("--at", "x=-0.3,y=1.2,z=0.4")


def call(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def positions(motion: Motion) -> np.ndarray:
    return fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]


def test_map_prints_a_table_with_both_figures() -> None:
    found = call("map", "unreal", "--goals", 2).stdout
    for word in ("upperarm_l", "LeftArm", "spine_02", "effector to its scaled goal", "slide of standing feet"):
        assert word in found


@pytest.mark.parametrize("command", ["map", "export"])
def test_the_help_names_every_target(command: str) -> None:
    text = call(command, "--help").stdout
    for word in (*PRESETS, "mapping.toml", *TARGETS):
        assert word in text


def test_map_as_json_names_every_joint() -> None:
    found = json.loads(call("map", "smpl", "--goals", 2, "--goal", "world", "--json").stdout)
    rows = {row["target"]: row for row in found["joints"]}
    assert list(rows) == list(preset("smpl").skeleton.names)
    assert rows["left_wrist"] == {
        "target": "left_wrist", "bone": "leftHand", "source": "LeftHand", "second": None, "share": 0.0, "how": "bone",
    }  # fmt: skip
    assert (found["goal"], found["figures"]["goals"]) == ("world", 2)
    assert found["figures"]["worst"]["effector_m"] < 0.01


def test_a_written_mapping_can_be_given_back(tmp_path: Path) -> None:
    call("map", "mixamo", "--goals", 0, "-o", tmp_path / "mapping.toml")
    first = json.loads(call("map", "mixamo", "--goals", 0, "--json").stdout)
    again = json.loads(call("map", tmp_path / "mapping.toml", "--goals", 0, "--json").stdout)
    key = [(row["target"], row["source"], row["second"]) for row in first["joints"]]
    assert key == [(row["target"], row["source"], row["second"]) for row in again["joints"]]


def test_a_mapping_that_is_given_back_keeps_all_its_parts(tmp_path: Path) -> None:
    (tmp_path / "first.toml").write_text(
        'preset = "vrm"\n[root]\nscale = 0.9\ntravel = "world"\n[ground]\nheight = 0.3\nfeet = false\n'
        '[effector]\ngoal = "world"\n[joints]\nNeck = ""\nRightArm = ""\nLeftHand = "leftLowerArm"\n'
    )
    found = []
    for name, written in (("first", "second"), ("second", "third")):
        result = call("map", tmp_path / f"{name}.toml", "--goals", 0, "-o", tmp_path / f"{written}.toml", "--json")
        found.append(json.loads(result.stdout)["joints"])
    key = [[(row["target"], row["source"], row["second"]) for row in rows] for rows in found]
    assert key[0] == key[1]
    moved = {source for _, source, _ in key[0]}
    assert "RightForeArm" in moved
    assert not {"RightArm", "Neck"} & moved
    first, second = (open_mapping(str(tmp_path / f"{name}.toml")) for name in ("first", "second"))
    for part in ("goal", "scale", "travel", "feet", "height"):
        assert getattr(first, part) == getattr(second, part)
    assert first.rig.ground == second.rig.ground == 0.3
    assert (tmp_path / "second.toml").read_text() == (tmp_path / "third.toml").read_text()


@pytest.mark.parametrize("form", ["bvh", "glb", "npz", "vrma"])
def test_export_writes_a_mapped_motion(tmp_path: Path, form: str) -> None:
    result = call("export", "reach", *AT, "--map", "vrm", "-o", tmp_path / f"out.{form}")
    assert "effector 0.0 mm" in " ".join(result.stderr.split())
    if form != "vrma":
        motion = motion_files.read(tmp_path / f"out.{form}").motion
        assert motion.skeleton.names == preset("vrm").skeleton.names


def test_export_writes_a_vrm_animation_of_a_target_with_a_root_above_the_hips(tmp_path: Path) -> None:
    call("export", "reach", *AT, "--map", "unreal", "-o", tmp_path / "out.vrma")
    document = open_document(tmp_path / "out.vrma")
    bones = document.table["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
    assert document.rows("nodes")[bones["leftUpperArm"]["node"]]["name"] == "upperarm_l"
    assert document.rows("nodes")[bones["hips"]["node"]]["name"] == "pelvis"


def test_export_adds_the_motion_to_the_file_of_the_target(tmp_path: Path) -> None:
    (tmp_path / "hero.vrm").write_bytes(avatar(library.load("reach").skeleton, scale=1.2, limbs=0.9, turned=True))
    call("export", "reach", *AT, "--map", tmp_path / "hero.vrm", "-o", tmp_path / "out.glb")
    call("export", "reach", *AT, "--map", tmp_path / "hero.vrm", "-o", tmp_path / "out.bvh")
    assert gltf.clip_names(tmp_path / "out.glb") == ("reach",)
    file, plain = (motion_files.read(tmp_path / f"out.{form}").motion for form in ("glb", "bvh"))
    assert file.skeleton.names == plain.skeleton.names
    np.testing.assert_allclose(positions(file), positions(plain), atol=1e-5)
    rig = read_rig(tmp_path / "out.glb")  # it still rests as it did, and names its bones
    np.testing.assert_allclose(rig.rest, read_rig(tmp_path / "hero.vrm").rest, atol=1e-9)
    assert rig.given


def values(path: Path, count: int) -> list[np.ndarray]:
    """Values of the first accessors of a file; indices are left out."""
    document = open_document(path)
    rows = document.rows("accessors")[:count]
    kept = [k for k, row in enumerate(rows) if row["componentType"] == 5126]
    return [Accessors(document).array(k, "", rows[k]["type"], 10**6) for k in kept]


def test_all_buffers_of_the_target_are_in_the_file_that_is_written(tmp_path: Path) -> None:
    rig = preset("mixamo")
    still = Motion(rig.skeleton, 30.0, np.tile([0.0, 0.96, 0.0], (2, 1)), np.stack([rig.rest, rig.rest]))
    content = gltf_writer.dump(still)
    (tmp_path / "whole.glb").write_bytes(content)
    (tmp_path / "hero.glb").write_bytes(split(content, tmp_path))
    (tmp_path / "away").mkdir()
    for name in ("whole", "hero"):
        call("export", "reach", *AT, "--map", tmp_path / f"{name}.glb", "-o", tmp_path / "away" / f"{name}.glb")
    found = open_document(tmp_path / "away" / "hero.glb")
    (buffer,) = found.rows("buffers")
    for view in found.rows("bufferViews"):
        assert view["buffer"] == 0
        assert view["byteOffset"] + view["byteLength"] <= buffer["byteLength"]
    count = len(found.rows("accessors"))
    one, two = (values(tmp_path / "away" / f"{name}.glb", count) for name in ("whole", "hero"))
    assert len(one) == len(two) > 5
    for first, second in zip(one, two, strict=True):
        np.testing.assert_array_equal(first, second)


def test_a_target_with_images_beside_it_is_written_as_a_skeleton(tmp_path: Path) -> None:
    content = avatar(library.load("reach").skeleton)
    size = struct.unpack_from("<I", content, 12)[0]
    table = json.loads(content[20 : 20 + size]) | {"images": [{"uri": "skin.png"}]}
    (tmp_path / "hero.glb").write_bytes(glb(table, b""))
    result = call("export", "reach", *AT, "--map", tmp_path / "hero.glb", "-o", tmp_path / "out.glb")
    assert "without the mesh" in " ".join(result.stderr.split())
    assert not open_document(tmp_path / "out.glb").rows("images")
    assert gltf.clip_names(tmp_path / "out.glb") == ("reach",)


def test_wrong_targets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="robot"):
        call("export", "reach", *AT, "--map", "robot", "-o", tmp_path / "out.bvh")
    with pytest.raises(RequestError, match="--map"):
        call("export", "reach", *AT, "--goal", "world", "-o", tmp_path / "out.bvh")
    with pytest.raises(RequestError, match="neither bones"):
        call("map", "vrm", "--verb", "arm3")
