import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs import broken_clips as broken
from tests.verbs.sources import arm_source
from verbs.cli import app
from verbs.clips.mirror import mirror
from verbs.errors import MotionFileError, OutOfRange, SourceError
from verbs.io import bvh, motion_files


def call(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.stderr
    return result


@pytest.fixture
def file(tmp_path):
    bvh.write(broken.clean(), tmp_path / "clip.bvh", decimals=9)
    return tmp_path / "clip.bvh"


def test_trim_and_resample_write_files(tmp_path, file):
    result = call("trim", file, "--from", 0.25, "--to", 1.0, "-o", tmp_path / "part.bvh")
    assert "46 frames, 0.750 s at 60 fps" in result.stdout
    assert len(bvh.read(tmp_path / "part.bvh")) == 46
    row = json.loads(call("resample", tmp_path / "part.bvh", "--fps", 30, "-o", tmp_path / "slow.bvh", "--json").stdout)
    assert (row["frames"], row["fps"], row["seconds"]) == (23, 30.0, pytest.approx(22 / 30))
    assert bvh.read(tmp_path / "slow.bvh").fps == 30.0


def test_the_unit_of_a_file_is_kept(tmp_path):
    bvh.write(broken.clean().scaled(100.0), tmp_path / "cm.bvh")
    call("mirror", tmp_path / "cm.bvh", "-o", tmp_path / "out.bvh", "--unit", "cm")
    assert broken.apart_m(bvh.read(tmp_path / "out.bvh", unit="cm"), mirror(broken.clean()).motion) < 1e-5


def test_mirror_of_a_file_a_folder_and_a_source(tmp_path, file):
    call("mirror", file, "-o", tmp_path / "one.bvh")
    assert broken.apart_m(bvh.read(tmp_path / "one.bvh"), mirror(broken.clean()).motion) < 1e-6
    loose = tmp_path / "loose"
    loose.mkdir()
    file.rename(loose / "clip.bvh")
    row = json.loads(call("mirror", loose, "-o", tmp_path / "many", "--json").stdout)
    assert (row["clips"], row["unmatched"], row["bones_mm"]) == (1, [], {})
    assert (tmp_path / "many" / "clip.bvh").exists()
    result = call("mirror", arm_source(tmp_path / "arm"), "-o", tmp_path / "arm2")
    assert "5 clips mirrored" in result.stdout
    assert (tmp_path / "arm2" / "verb.toml").exists()


def test_mirror_reports_bones_and_joints_without_a_partner(tmp_path):
    odd = broken.scaled(broken.clean(), 1.0, joints={"RightForeArm": 1.1})
    bvh.write(odd, tmp_path / "odd.bvh")
    text = (tmp_path / "odd.bvh").read_text().replace("JOINT LeftToeBase", "JOINT LeftTip")
    (tmp_path / "odd.bvh").write_text(text)
    result = call("mirror", tmp_path / "odd.bvh", "-o", tmp_path / "out.bvh")
    assert "no partner for LeftTip, RightToeBase" in result.stderr
    assert "the bone to RightForeArm differs" in result.stderr
    (tmp_path / "pairs.toml").write_text('[pairs]\nLeftTip = "RightToeBase"\n')
    result = call("mirror", tmp_path / "odd.bvh", "-o", tmp_path / "out.bvh", "--pairs", tmp_path / "pairs.toml")
    assert "no partner" not in result.stderr


def test_the_ending_decides_the_format(tmp_path, file):
    call("trim", file, "--from", 0, "--to", 0.5, "-o", tmp_path / "a.npz")
    call("trim", file, "--from", 0, "--to", 0.5, "-o", tmp_path / "a.bvh")
    one, other = (motion_files.read(tmp_path / f"a.{ending}").motion for ending in ("npz", "bvh"))
    np.testing.assert_allclose(one.root, other.root, atol=1e-7)
    call("trim", file, "--from", 0, "--to", 0.5, "-o", tmp_path / "a.glb")
    np.testing.assert_allclose(motion_files.read(tmp_path / "a.glb").motion.root, one.root, atol=1e-6)
    for name in ("a", "a.txt"):
        with pytest.raises(MotionFileError, match=r"a name that ends in \.bvh or \.glb or"):
            call("trim", file, "--from", 0, "--to", 0.5, "-o", tmp_path / name)
        assert not (tmp_path / name).exists()


def test_what_is_wrong_is_named(tmp_path, file):
    with pytest.raises(OutOfRange, match="the length of the motion"):
        call("trim", file, "--from", 0, "--to", 100, "-o", tmp_path / "a.bvh")
    (tmp_path / "none").mkdir()
    with pytest.raises(SourceError, match=r"neither a verb.toml nor motion files"):
        call("mirror", tmp_path / "none", "-o", tmp_path / "b")
    with pytest.raises(SourceError, match="is not empty"):
        call("mirror", tmp_path, "-o", tmp_path)
    for text, message in (('LeftHand = "R', "table of pairs in TOML"), ("LeftHand = 3", "pairs of joint names")):
        (tmp_path / "pairs.toml").write_text(text)
        with pytest.raises(MotionFileError, match=message):
            call("mirror", file, "-o", tmp_path / "a.bvh", "--pairs", tmp_path / "pairs.toml")
    with pytest.raises(MotionFileError, match="can be read"):
        call("mirror", file, "-o", tmp_path / "a.bvh", "--pairs", tmp_path / "absent.toml")
