"""Archives of the clients that are no packages."""

import io
import tomllib
import zipfile

from tools import dist, godot3


def test_the_same_files_give_the_same_archive(tmp_path):
    dist.write(tmp_path / "a")
    dist.write(tmp_path / "b")
    names = {path.name for path in (tmp_path / "a").iterdir()}
    assert names == {"Adverb.cs", "adverb-blender.zip", "adverb-godot3.zip", "adverb-godot4.zip"}
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_blender_archive_has_its_manifest_at_the_top():
    files = dist.blender()
    manifest = tomllib.loads(files["blender_manifest.toml"].decode())
    assert (manifest["id"], manifest["type"]) == ("adverb_blender", "add-on")
    assert {"__init__.py", "ui.py", "rest.py", "LICENSE"} <= files.keys()


def test_the_godot_archives_have_the_addon_and_the_demo():
    for files in (dist.godot(), godot3.files()):
        assert {"addons/adverb/plugin.cfg", "addons/adverb/adverb_figure.gd", "demo/demo.tscn"} <= files.keys()
    names = zipfile.ZipFile(io.BytesIO(dist.zip_bytes(dist.godot()))).namelist()
    assert names == sorted(names)
