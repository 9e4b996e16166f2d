import json
import subprocess
import sys
from importlib import metadata

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs import walker
from tests.verbs.sources import arm_source
from verbs import library
from verbs.blend.methods import METHODS
from verbs.cli import app, run
from verbs.cli.options import METHODS as HELP_METHODS
from verbs.cli.options import open_verb, parse_at
from verbs.errors import MotionFileError, OutOfRange, RequestError, UnknownName
from verbs.io import bvh, motion_files

FIELDS = {
    "error_mean_m", "error_max_m", "error_mean_pct", "error_max_pct", "smoothness", "smoothness_max", "precompute_s",
    "query_us", "samples", "domain", "grid", "support_mean", "support_min",
}  # fmt: skip

AT = ("--at", "x=0.5,y=0.2")


def call(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_build_writes_a_verb_and_reports(tmp_path):
    result = call("build", arm_source(tmp_path / "arm"), "-o", tmp_path / "arm.verb")
    for word in ("examples", "domain", "condition", "worst stored", "at examples", "inside, corrected"):
        assert word in result.stdout
    assert open_verb(str(tmp_path / "arm.verb")).name == "arm"


def test_build_reports_as_json(tmp_path):
    result = call("build", arm_source(tmp_path / "arm"), "-o", tmp_path / "arm.verb", "--json")
    report = json.loads(result.stdout)
    assert report["examples"] == 5
    assert report["methods"]["corrected"]["error_max_m"] < 1e-9


def test_info_prints_the_description_of_the_service():
    described = json.loads(call("info", "arm3", "--json").stdout)
    assert [adverb["name"] for adverb in described["adverbs"]] == ["x", "y"]
    assert described["skeleton"]["names"] == list(library.load("arm3").skeleton.names)
    assert described["keytime_names"] == ["start", "reach", "end"]
    assert "arm3" in call("info", "arm3").stdout


def test_info_gives_contacts_of_the_feet(tmp_path):
    folder = walker.source(tmp_path / "figure", {"jump": walker.jump(), "stand": walker.stand(2.5)})
    file = tmp_path / "figure.verb"
    built = json.loads(call("build", folder, "-o", file, "--json").stdout)
    assert [row["example"] for row in built["feet"]] == ["jump", "stand"]
    assert [row["stances"] for row in built["feet"]] == [12, 6]
    assert all(0 <= row["slide_p90_m"] <= row["slide_max_m"] < 0.03 for row in built["feet"])
    assert all(0 <= row["penetration_m"] < 0.01 for row in built["feet"])
    left, right = json.loads(call("info", file, "--json").stdout)["contacts"]
    assert (left["foot"], right["foot"], left["intervals"]) == ("LeftFoot", "RightFoot", 9)
    assert 0.85 < left["share"] < 0.95
    heel, ball, toe = left["points"]
    assert (heel["part"], ball["part"], toe["part"]) == ("heel", "ball", "toe")
    assert (heel["joint"], toe["joint"], toe["offset"]) == ("LeftFoot", "LeftToeBase", [0.0, 0.0, 0.07])
    assert [len(intervals) for intervals in ball["intervals"]] == [2, 1]
    assert ball["intervals"][1] == [[0.0, 1.0]]
    text = call("info", file).stdout
    assert f"LeftFoot: in contact {left['share']:.0%} of the motion" in text
    assert "9 intervals in all examples" in text
    assert "slide p90" in call("build", folder, "-o", file).stdout


def test_info_of_a_verb_without_feet_has_no_contacts():
    assert json.loads(call("info", "arm3", "--json").stdout)["contacts"] == []
    assert "in contact" not in call("info", "arm3").stdout


def test_pose_prints_one_pose():
    record = json.loads(call("pose", "arm3", "--at", "x=0.5,y=0.2", "--phase", "0.5", "--json").stdout)
    assert record["measured"]["x"] == pytest.approx(0.5, abs=1e-9)
    assert record["error"] < 1e-9
    assert 0.0 < record["support"] < 1.0
    assert len(record["rotations"]) == 4
    assert "measured x 0.5000 m, y 0.2000 m; error" in call("pose", "arm3", "--at", "x=0.5,y=0.2").stdout


def test_measure_prints_the_agreed_fields():
    figures = json.loads(call("measure", "arm3", "--method", "rbf", "--grid", "21", "--json").stdout)
    assert set(figures["methods"]["rbf"]) >= FIELDS
    assert "corrected" in call("measure", "arm3", "--grid", "11").stdout


def test_measure_takes_a_source_folder(mocap):
    figures = json.loads(call("measure", mocap / "punch", "--method", "rbf", "--grid", "11", "--json").stdout)
    assert set(figures["methods"]["rbf"]) >= FIELDS
    assert figures["methods"]["rbf"]["samples"] == 3000


def test_the_ending_of_a_file_names_its_format(tmp_path):
    for name, form in (("one.bvh", ()), ("TWO.BVH", ()), ("three", ()), ("four.bvh", ("--format", "bvh"))):
        call("export", "arm3", *AT, "-o", tmp_path / name, *form)
        assert (tmp_path / name).read_text().startswith("HIERARCHY")


@pytest.mark.parametrize("name", ["m.glb", "M.GLB", "m.npz", "m"])
def test_every_format_is_exported_and_reads_back(name, tmp_path):
    form = ("--format", "glb") if name == "m" else ()
    call("export", "arm3", *AT, "-o", tmp_path / "m.bvh")
    call("export", "arm3", *AT, "-o", tmp_path / name, *form)
    if name == "m":
        (tmp_path / name).rename(tmp_path / "n.glb")
        name = "n.glb"
    found, expected = (motion_files.read(tmp_path / each).motion for each in (name, "m.bvh"))
    assert found.skeleton.names == expected.skeleton.names
    np.testing.assert_allclose(found.root, expected.root, atol=1e-6)
    np.testing.assert_allclose(np.abs((found.rotations * expected.rotations).sum(axis=-1)), 1.0, atol=1e-6)


def test_a_glb_has_a_body_unless_it_is_left_out(tmp_path):
    call("export", "reach", "--at", "x=-0.3,y=1.2,z=0.4", "-o", tmp_path / "body.glb")
    call("export", "reach", "--at", "x=-0.3,y=1.2,z=0.4", "-o", tmp_path / "bones.glb", "--no-mannequin")
    assert b'"name":"Mannequin"' in (tmp_path / "body.glb").read_bytes()
    assert b'"name":"Mannequin"' not in (tmp_path / "bones.glb").read_bytes()
    assert (
        b'"extras":{"verb":"reach","adverbs":{"x":-0.3,"y":1.2,"z":0.4},"fps":30.0}'
        in (tmp_path / "bones.glb").read_bytes()
    )


def test_errors_have_a_prefix_for_people_and_si_in_json(tmp_path):
    shown = call("measure", "arm3", "--method", "rbf", "--grid", "5").stdout
    row = json.loads(call("measure", "arm3", "--method", "rbf", "--grid", "5", "--json").stdout)["methods"]["rbf"]
    assert 0.001 < row["error_max_m"] < 1.0
    assert f"{1000 * row['error_max_m']:.3g} mm" in shown


def test_export_writes_a_motion_that_reaches_the_goal(tmp_path):
    call("export", "arm3", "--at", "x=0.5,y=0.2", "-o", tmp_path / "arm.bvh", "--fps", "60")
    motion = bvh.read(tmp_path / "arm.bvh")
    assert motion.fps == 60
    assert motion.skeleton.names == library.load("arm3").skeleton.names


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (["info", "unknown"], UnknownName, "unknown verb 'unknown'; known: arm3, board, "),
        (["gallery", "unknown"], UnknownName, "unknown verb 'unknown'; known: arm3, board, "),
        (["pose", "arm3", "--at", "x=one"], OutOfRange, "write name=value"),
        (["pose", "arm3", "--at", "x=0.1,y=0.1", "--method", "magic"], UnknownName, "unknown method 'magic'"),
        (["export", "arm3", *AT, "-o", "m", "--format", "fbx"], RequestError, "'fbx' is not supported; known: bvh"),
        (["export", "arm3", *AT, "-o", "m.fbx"], RequestError, "format 'fbx' is not supported; known: bvh"),
        (["export", "arm3", *AT, "-o", "m.vrma"], RequestError, r"no VRM humanoid: it has no joint for hips \(Hips\)"),
        (["export", "arm3", *AT, "-o", "m.fbx", "--format", "bvh"], RequestError, "ends in .fbx, but --format is bvh"),
        (["export", "arm3", *AT, "-o", "."], RequestError, "is a folder"),
        (["export", "arm3", *AT, "-o", "no/folder/m.bvh"], MotionFileError, "no/folder/m.bvh"),
    ],
)
def test_a_user_error_is_typed(arguments, error, message):
    with pytest.raises(error, match=message):
        call(*arguments)


def test_a_user_error_is_one_line_and_exit_code_1(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["adverb", "info", "unknown"])
    with pytest.raises(SystemExit) as left:
        run(app)
    assert left.value.code == 1
    assert capsys.readouterr().err.startswith("error: unknown verb 'unknown'")


def test_wrong_usage_is_exit_code_2():
    assert CliRunner().invoke(app, ["pose"]).exit_code == 2


def test_adverbs_are_read_from_text():
    assert parse_at("x=0.5, y=-1e-3") == {"x": 0.5, "y": -1e-3}


def test_help_needs_nothing_that_takes_seconds():
    code = "import sys, service.cli; print({'numba', 'scipy', 'fastapi', 'dbos'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"


def test_help_names_every_method():
    assert HELP_METHODS.split(", ") == list(METHODS)


def test_every_command_shows_an_example():
    for command in ("build", "info", "pose", "measure", "refine", "export", "figures", "gallery"):
        assert "Example" in call(command, "--help").stdout


def test_the_version_is_that_of_the_package():
    assert call("--version").stdout == f"adverb {metadata.version('adverb')}\n"


def test_a_loop_can_be_exported_for_several_cycles(mocap, tmp_path):
    arguments = ("--at", "forward_speed=1.2,turn_rate=0,sideways_speed=0", "-o", tmp_path / "walk.bvh")
    call("export", mocap / "locomotion", *arguments, "--cycles", "3")
    motion = bvh.read(tmp_path / "walk.bvh")
    speed = np.linalg.norm(motion.root[-1, [0, 2]]) / motion.duration_s
    assert speed == pytest.approx(1.2, rel=0.05)


def test_shell_completion_can_be_installed():
    options = CliRunner().invoke(app, ["--help"]).stdout
    assert "--install-completion" in options
    assert "--show-completion" in options
