"""glTF files that are wrong: each error names the place; damaged bytes raise nothing else."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.verbs.gltf_files import Gltf, body_file, random_rotations
from verbs.errors import MotionFileError
from verbs.io import gltf
from verbs.motion import Motion


def small() -> Gltf:
    """Two joints, one channel: accessors 0 (times) and 1 (rotations)."""
    source = Gltf()
    joint = source.node("a")
    source.node("b", joint, translation=[0, 1, 0])
    source.channel(
        source.animation("turn"), joint, "rotation", np.arange(9) / 8, random_rotations(np.random.default_rng(0), 9)
    )
    return source


def refused(path: Path, **options) -> MotionFileError:
    with pytest.raises(MotionFileError) as caught:
        gltf.read_file(path, **options)
    assert caught.value.path == str(path)
    return caught.value


def test_a_signalling_nan_is_refused_without_a_warning(tmp_path):
    path = tmp_path / "a.glb"
    content = small().glb()
    number = np.float32(1 / 8).tobytes()  # the second time
    assert number in content
    path.write_bytes(content.replace(number, (0x7F800001).to_bytes(4, "little"), 1))
    assert refused(path).expected == "finite numbers"


# What is changed to what; the place and the expectation and the finding that the error must state.
WRONG = {
    "no asset": ("asset", None, "JSON chunk", "an object with 'asset'", "'nodes'"),
    "version 1": ("asset.version", "1.0", "asset", "version 2", "1.0"),
    "nodes are no list": ("nodes", {}, "nodes", "a list of objects", "{}"),
    "a child that is missing": ("nodes.0.children", [7], "nodes[0]", "'children' as a list of indices below 2", "[7]"),
    "a child of itself": ("nodes.1.children", [1], "nodes[1]", "one parent", "nodes 0 and 1"),
    "a circle": ("nodes.1.children", [0], "nodes[0]", "a tree", "a node that is below itself"),
    "a bad rotation": ("nodes.1.rotation", [0, 0, 0, 0], "nodes[1]", "a unit quaternion", "[0.0, 0.0, 0.0, 0.0]"),
    "a short translation": ("nodes.1.translation", [1, 2], "nodes[1]", "'translation' as 3 finite numbers", "[1, 2]"),
    "a mirror": ("nodes.0.scale", [-1, 1, 1], "nodes[0]", "a positive scale", "[-1.0, 1.0, 1.0]"),
    "a sheared matrix": (
        "nodes.0.matrix",
        [1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        "nodes[0]",
        "a matrix without shear",
        "",
    ),
    "a mirrored matrix": (
        "nodes.0.matrix",
        [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        "nodes[0]",
        "a matrix of rotation and positive scale",
        "",
    ),
    "no animation": ("animations", [], "animations", "an animation", "none"),
    "a sampler that is missing": (
        "animations.0.channels.0.sampler",
        3,
        "animations[0].channels[0]",
        "one of 2 nodes and 1 samplers",
        "node 0, sampler 3",
    ),
    "two channels of a node": (
        "animations.0.channels",
        [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}] * 2,
        "animations[0].channels[1]",
        "one channel for each node and path",
        "a second one for the rotation of node 0",
    ),
    "an unknown interpolation": (
        "animations.0.samplers.0.interpolation",
        "SMOOTH",
        "animations[0].samplers[0]",
        "interpolation LINEAR, STEP, CUBICSPLINE",
        "'SMOOTH'",
    ),
    "cubic keys that are plain": (
        "animations.0.samplers.0.interpolation",
        "CUBICSPLINE",
        "accessors[1]",
        "27 values for 9 keys",
        "9",
    ),
    "an accessor that is missing": (
        "animations.0.samplers.0.output",
        9,
        "animations[0].samplers[0]",
        "the index of one of 2 accessors",
        "9",
    ),
    "rotations of three numbers": ("accessors.1.type", "VEC3", "accessors[1]", "type VEC4", "VEC3"),
    "more than there is": ("accessors.1.count", 90, "accessors[1]", "elements inside the 144 bytes", "90 elements"),
    "a huge claim": ("accessors.1.count", 10**9, "accessors[1]", "1 to 600000 elements", "1000000000"),
    "no elements": ("accessors.0.count", 0, "accessors[0]", "1 to 200000 elements", "0"),
    "a fractional count": ("accessors.0.count", 2.5, "accessors[0]", "'count' as a whole number", "2.5"),
    "a negative offset": ("accessors.1.byteOffset", -4, "accessors[1]", "'byteOffset' as a whole number", "-4"),
    "an unknown component": ("accessors.1.componentType", 5124, "accessors[1]", "componentType 5120, 5121", "5124"),
    "no data": ("accessors.1.bufferView", None, "accessors[1]", "a bufferView, or sparse values", "neither"),
    "a view too long": (
        "bufferViews.1.byteLength",
        9999,
        "bufferViews[1]",
        "a range in 180 bytes",
        "bytes 36 to 10035",
    ),
    "overlapping elements": ("bufferViews.1.byteStride", 4, "accessors[1]", "elements inside", "every 4"),
    "compression": (
        "bufferViews.1.extensions",
        {"EXT_meshopt_compression": {}},
        "bufferViews[1]",
        "plain data",
        "compression by EXT_meshopt_compression",
    ),
    "a sparse claim": (
        "accessors.1.sparse",
        {"count": 10**6, "indices": {}, "values": {}},
        "accessors[1].sparse",
        "1 to 9 elements",
        "1000000",
    ),
    "falling times": ("accessors.0.byteOffset", 4, "accessors[0]", "elements inside", "9 elements of 4 bytes"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_refused_with_its_place(name, tmp_path):
    where, value, place, expected, found = WRONG[name]
    source = small()
    row, keys = source.table, where.split(".")
    for key in keys[:-1]:
        row = row[int(key) if key.isdigit() else key]
    if value is None:
        del row[keys[-1]]
    else:
        row[int(keys[-1]) if keys[-1].isdigit() else keys[-1]] = value
    error = refused(source.write(tmp_path / "wrong.glb"))
    assert (error.place, error.line) == (place, None)
    assert expected in error.expected
    assert found in error.found
    assert f"wrong.glb, {place}: expected " in str(error)


@pytest.mark.parametrize(
    ("code", "place"), [(float("nan"), "accessors[1]"), (float("inf"), "accessors[1]"), (1e5, "accessors[1]")]
)
def test_keys_that_are_no_rotations_are_refused(code, place, tmp_path):
    source = small()
    struct.pack_into("<f", source.data, 36 + 32, code)
    error = refused(source.write(tmp_path / "wrong.glb"))
    assert error.place == place
    assert "element 2" in error.found or "key 2" in error.found


def test_falling_times_are_refused(tmp_path):
    source = small()
    struct.pack_into("<f", source.data, 8, 0.1)
    assert refused(source.write(tmp_path / "wrong.glb")).expected == "rising times in seconds"


@pytest.mark.parametrize(
    ("content", "place", "expected"),
    [
        (b"", "JSON", "a glTF file: valid JSON"),
        (b"glTF", "header", "12 bytes"),
        (b"glTF\x01\0\0\0\x0c\0\0\0", "header", "version 2"),
        (b"glTF\x02\0\0\0\x0c\0\0\0", "first chunk", "JSON"),
        (b"glTF\x02\0\0\0\xff\0\0\0", "header", "255 bytes"),
        (b"glTF\x02\0\0\0\x14\0\0\0\xff\0\0\0JSON", "chunk at byte 20", "at most 0 bytes"),
        (b"glTF\x02\0\0\0\x14\0\0\0\0\0\0\0BIN\0", "first chunk", "JSON"),
        (b"[1, 2]", "JSON", "an object with 'asset'"),
        (b'{"asset": {"version": NaN}}', "JSON", "a glTF file: valid JSON"),
        (b"[" * 100_000, "JSON", "a glTF file: valid JSON"),
        (b'{"a": ' + b"9" * 5000 + b"}", "JSON", "a glTF file: valid JSON"),
        (b"\xff\xfe", "JSON", "a glTF file: valid JSON"),
    ],
)
def test_what_is_no_gltf_is_refused(content, place, expected, tmp_path):
    (tmp_path / "wrong.gltf").write_bytes(content)
    error = refused(tmp_path / "wrong.gltf")
    assert (error.place, error.expected) == (place, expected)


@pytest.mark.parametrize(
    "uri",
    ["../secret.bin", "/etc/hostname", "file:///etc/hostname", "http://host/a.bin", "%2e%2e/secret.bin", "a\0b", "."],
)
def test_a_buffer_outside_the_folder_is_refused(uri, tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(1000))
    (tmp_path / "folder").mkdir()
    path = tmp_path / "folder" / "clip.gltf"
    path.write_text(json.dumps(small()._scene({"byteLength": 180, "uri": uri})))
    error = refused(path)
    assert error.place == "buffers[0]"
    assert "put the buffer beside the file" in error.advice


def test_a_link_out_of_the_folder_is_refused(tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(1000))
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "link.bin").symlink_to(tmp_path / "secret.bin")
    path = tmp_path / "folder" / "clip.gltf"
    path.write_text(json.dumps(small()._scene({"byteLength": 180, "uri": "link.bin"})))
    assert refused(path).expected == "a uri inside the file's own folder"


def test_a_missing_buffer_file_and_a_short_one_are_named(tmp_path):
    path = small().write(tmp_path / "clip.gltf")
    (tmp_path / "clip data.bin").write_bytes(b"123")
    assert refused(path).found == "3 bytes"
    (tmp_path / "clip data.bin").unlink()
    assert "'clip%20data.bin': No such file" in refused(path).found


def test_data_that_is_not_base64_is_refused(tmp_path):
    path = tmp_path / "clip.gltf"
    path.write_text(json.dumps(small()._scene({"byteLength": 180, "uri": "data:;base64,!!!"})))
    assert refused(path).expected == "base64 data in the uri"


def test_a_long_clip_at_a_high_rate_is_refused_before_memory_is_taken(tmp_path):
    source = Gltf()
    joint = source.node("a")
    source.channel(source.animation(), joint, "rotation", [0.0, 900_000.0], [[0, 0, 0, 1], [0, 0, 1, 0]])
    error = refused(source.write(tmp_path / "long.glb"), fps=1000.0)
    assert "at most 200000 frames" in error.expected
    assert refused(source.write(tmp_path / "long.glb"), fps=0.0).found == "0.0"


def test_deep_and_wide_hierarchies_are_refused_without_a_long_search(tmp_path):
    deep, wide = Gltf(), Gltf()
    for k in range(20_000):
        deep.node(None, k - 1 if k else None)
        wide.node()
    for source in (deep, wide):
        for node in range(0, 20_000, 50):
            source.channel(
                source.animation() if not node else source.table["animations"][0],
                node,
                "rotation",
                [0.0],
                [[0, 0, 0, 1]],
            )
        error = refused(source.write(tmp_path / "large.glb"))
        assert error.expected in ("at most 1000 joints", "one tree of joints larger than the others")


BODY = bytes(body_file("CUBICSPLINE", frames=4).glb())
TEXT = body_file(frames=4).embedded().encode()


@given(st.data())
@settings(max_examples=400, deadline=None)
def test_damaged_files_give_a_motion_or_a_motion_file_error(tmp_path_factory, data):
    content = bytearray(data.draw(st.sampled_from([BODY, TEXT])))
    head = 6000 if content[:4] == b"glTF" else len(content)
    for _ in range(data.draw(st.integers(1, 6))):
        start = data.draw(st.integers(0, head))
        wound = data.draw(
            st.sampled_from([b"0", b"9", b"-", b"}", b"]", b",", b"null", b"1e9", b"\0", b"\xff" * 8, b'"'])
        )
        kind = data.draw(st.integers(0, 3))
        if kind == 0:
            content[start : start + len(wound)] = wound
        elif kind == 1:
            del content[start : start + data.draw(st.integers(1, 30))]
        elif kind == 2:
            content[start:start] = wound
        else:
            del content[start:]
    path = tmp_path_factory.getbasetemp() / "damaged.glb"
    path.write_bytes(bytes(content))
    try:
        assert isinstance(gltf.read_file(path).motion, Motion)
    except MotionFileError as err:
        assert str(path) in str(err)  # noqa: PT017  # both outcomes are right


def edits(value, rng: np.random.Generator):
    """The JSON value with one entry somewhere replaced by something else."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(sorted(value))
        return value | {str(key): edits(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.9:
        k = int(rng.integers(len(value)))
        return [*value[:k], edits(value[k], rng), *value[k + 1 :]]
    return [None, -1, 0, 1, 2.5, 1e300, 10**30, "x", [], {}, True, [0] * 4, {"node": 0}][int(rng.integers(13))]


def test_files_with_another_value_anywhere_give_a_motion_or_a_motion_file_error(tmp_path):
    rng, table, refusals = np.random.default_rng(4), json.loads(TEXT), 0
    path = tmp_path / "edited.gltf"
    for _ in range(1500):
        path.write_text(json.dumps(edits(table, rng)))
        try:
            assert isinstance(gltf.read_file(path).motion, Motion)
        except MotionFileError:
            refusals += 1
    assert 300 < refusals < 1500
