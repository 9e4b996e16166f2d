"""The addon for Godot 3 is made of the sources for Godot 4."""

import re

import pytest

from tools import godot3

SOURCES = sorted(path for path in godot3.CLIENT.rglob("*.gd") if "godot3" not in path.relative_to(godot3.CLIENT).parts)
BY_HAND = {path.name for path in (godot3.CLIENT / "godot3").glob("*.gd")}


def test_names_are_translated():
    source = "@tool\nextends Node3D\n@export var a: int = 1\nvar b = PackedByteArray()\nvar c: Quaternion\n"
    assert (
        godot3.translate(source)
        == "tool\nextends Spatial\nexport var a: int = 1\nvar b = PoolByteArray()\nvar c: Quat\n"
    )
    assert godot3.translate("var MyNode3DView = name_RefCounted") == "var MyNode3DView = name_RefCounted"


def test_files_by_hand_replace_those_of_the_addon():
    files = godot3.files()
    for name in BY_HAND:
        assert files[f"addons/adverb/{name}"] == (godot3.CLIENT / "godot3" / name).read_bytes()
        assert (godot3.CLIENT / godot3.ADDON / name).exists()
    assert {"platform.gd", "socket.gd"} == BY_HAND


def functions(source):
    return set(re.findall(r"^(?:static )?func (\w+)\(([^)]*)\)", source, re.MULTILINE))


@pytest.mark.parametrize("name", sorted(BY_HAND))
def test_files_by_hand_have_the_same_functions(name):
    ours = functions((godot3.CLIENT / godot3.ADDON / name).read_text("utf-8"))
    theirs = functions((godot3.CLIENT / "godot3" / name).read_text("utf-8"))
    private = {row for row in theirs if row[0].startswith("_")}
    assert theirs - private == ours


@pytest.mark.parametrize("path", [path for path in SOURCES if path.name not in BY_HAND], ids=lambda path: path.name)
def test_sources_use_what_both_versions_have(path):
    source = path.read_text("utf-8")
    assert not re.search(r"(?<![\w.])(min|max|clamp)\(", source), "they round to single precision in Godot 3: Numbers"
    found = re.findall(r"\b(?:await|super|Callable|lambda|yield|setget|Time|OS|JSON)\b[.(]|\.emit\(|\.slice\(", source)
    assert not [each for each in found if each != ".slice("] + re.findall(r"(?<!Platform)\.slice\(", source)
