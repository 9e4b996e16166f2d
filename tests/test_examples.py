"""Every numbered example runs, and prints its result."""

import re
import runpy
from pathlib import Path

import pytest

from tests.service.catalog.conftest import PATIENCE_S, Kept

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Address of a server with a data folder and one worker."""
    server = Kept(data=tmp_path_factory.mktemp("examples"), refiners=1).start(PATIENCE_S)
    yield f"http://127.0.0.1:{server.port}"
    server.stop()


def run(name, *arguments):
    """Run an example's ``main``, as its command line does."""
    runpy.run_path(str(EXAMPLES / name))["main"](*arguments)


def test_examples_are_numbered_without_gaps_and_all_tested():
    names = sorted(path.name for path in EXAMPLES.glob("*.py"))
    assert [name[:3] for name in names] == [f"{k:02d}_" for k in range(1, len(names) + 1)]
    tested = set(re.findall(r'run\("([^"]+)"', Path(__file__).read_text()))
    assert tested == set(names)


def test_01_draws_a_picture(tmp_path, capsys):
    run("01_picture.py", str(tmp_path / "reach.png"))
    assert (tmp_path / "reach.png").read_bytes().startswith(b"\x89PNG")
    assert float(re.search(r"largest error (\S+) m", capsys.readouterr().out)[1]) < 1e-6


def test_02_requests_a_pose(address, capsys):
    run("02_pose.py", address)
    assert "wrist at -0.300 1.200 0.400 m, error" in capsys.readouterr().out


def test_03_requests_a_crowd(address, capsys):
    run("03_crowd.py", address)
    assert "1000 poses, rotations (1000, 28, 4)" in capsys.readouterr().out


def test_04_streams_poses(address, capsys):
    run("04_stream.py", address, "1.5")
    assert int(re.search(r"(\d+) poses displayed", capsys.readouterr().out)[1]) > 5


def test_05_builds_a_verb(tmp_path, capsys):
    run("05_build.py", "", str(tmp_path / "arm.verb"))
    found = re.search(r"arm3: 9 examples, \d+ kB; error (\S+) mm", capsys.readouterr().out)
    assert float(found[1]) < 1e-3


def test_07_records_a_stream(address, tmp_path, capsys):
    run("07_record.py", address, str(tmp_path / "reach.npz"))
    shown = capsys.readouterr().out
    assert int(re.search(r"(\d+) frames", shown)[1]) > 20
    assert float(re.search(r"goal (\S+) mm at the end", shown)[1]) < 30.0
    assert (tmp_path / "reach.npz").read_bytes().startswith(b"PK")


def test_06_refines_a_verb(address, capsys):
    run("06_refine.py", address)
    shown = capsys.readouterr().out
    assert "published: 20 pseudo-examples" in shown
    assert "version 1 to 2" in shown
