"""Recordings of a channel, and the command that makes them."""

import asyncio
import importlib.util
import subprocess
import sys

import numpy as np
import pytest
from adverb_client import Client, DecodeError, Recorder, Recording, Stream
from typer.testing import CliRunner

import service.cli
from tests.clients.python.conftest import until
from verbs.cli import app

GOAL = [-0.3, 1.2, 0.4]


@pytest.fixture
async def recording(address, anyio_backend):
    with Client(address) as client:
        apex = client.verb("reach").keytimes["apex"]
    async with Stream(address) as stream:
        channel = await stream.open("reach", play=False, phase=apex, half_life=0.0)
        channel.aim(GOAL)
        with Recorder(channel, "RightHand") as recorder:
            await until(lambda: len(recorder) > 30)
        count = len(recorder)
        seen = stream.stats.messages
        await until(lambda: stream.stats.messages > seen + 5)
        assert len(recorder) == count  # it has ended
        return recorder.recording()


@pytest.mark.anyio
async def test_frames_and_goals_are_kept(recording):
    assert len(recording) > 30
    assert (np.diff(recording.times_s) > 0.0).all()
    assert recording.times_s[0] == 0.0
    assert recording.rotations.shape == (len(recording), len(recording.names), 4)
    np.testing.assert_allclose(recording.goals[-1], GOAL)
    hand = recording.positions()[-1, recording.names.tolist().index("RightHand")]
    np.testing.assert_allclose(hand, GOAL, atol=1e-4)
    assert recording.errors[-1] < 1e-5
    assert not recording.clamped[-1]


@pytest.mark.anyio
async def test_a_file_has_all_of_it(recording, tmp_path):
    recording.save(tmp_path / "reach.npz")
    again = Recording.load_npz(tmp_path / "reach.npz")
    assert (set(again.verbs), again.effector, len(again)) == ({"reach"}, "RightHand", len(recording))
    np.testing.assert_array_equal(again.rotations, recording.rotations)
    np.testing.assert_array_equal(again.positions(), recording.positions())
    np.savez(tmp_path / "other.npz", format=np.int64(1))
    np.savez(tmp_path / "newer.npz", format=np.int64(2))
    (tmp_path / "empty.npz").touch()
    (tmp_path / "cut.npz").write_bytes((tmp_path / "reach.npz").read_bytes()[:-100])
    for name in ("other", "newer", "empty", "cut"):
        with pytest.raises(DecodeError):
            Recording.load_npz(tmp_path / f"{name}.npz")
    with pytest.raises(ValueError, match="expected an ending"):
        recording.save(tmp_path / "reach.txt")


@pytest.mark.anyio
async def test_a_switch_has_the_adverbs_of_both_verbs(address, anyio_backend):
    async with Stream(address) as stream:
        channel = await stream.open("reach", adverbs=dict(zip("xyz", GOAL, strict=True)))
        with Recorder(channel) as recorder:
            await until(lambda: len(recorder) > 5)
            await stream.switch(channel, "jog")
            count = len(recorder)
            await until(lambda: len(recorder) > count + 5)
        found = recorder.recording()
    jog = found.verbs == "jog"
    assert set(found.verbs) == {"reach", "jog"}
    assert found.adverbs.tolist()[:3] == ["x", "y", "z"]
    assert found.goals.shape == (len(found), len(found.adverbs))
    np.testing.assert_allclose(found.goals[0, :3], GOAL)
    assert np.isnan(found.goals[jog][:, :3]).all()
    assert np.isnan(found.goals[~jog][:, 3:]).all()


@pytest.mark.anyio
@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed")
async def test_rerun_reads_its_file(recording, tmp_path):
    recording.save(tmp_path / "reach.rrd")
    checked = [sys.executable, "-m", "rerun", "rrd", "verify", str(tmp_path / "reach.rrd")]
    done = await asyncio.to_thread(subprocess.run, checked, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.anyio
async def test_channels_without_poses_are_refused(address, anyio_backend):
    async with Stream(address) as stream:
        for options in ({"encoding": "weights"}, {"space": "global"}, {"joints": ["Hips"]}):
            channel = await stream.open("arm3" if "joints" not in options else "reach", **options)
            with pytest.raises(ValueError, match="all joints"):
                Recorder(channel).__enter__()


def test_the_command(address, tmp_path):
    file = tmp_path / "reach.npz"
    given = ["record", "reach", "--url", address, "--seconds", "1", "--wander", "0.3", "--hold", "-o", str(file)]
    done = CliRunner().invoke(app, given)
    assert done.exit_code == 0, done.output
    found = Recording.load_npz(file)
    assert len(found) > 10
    assert len(np.unique(found.goals[np.isfinite(found.goals).all(axis=1)], axis=0)) > 1


def test_only_verbs_with_a_position_are_held(address, tmp_path):
    done = CliRunner().invoke(app, ["record", "jog", "--url", address, "--hold", "-o", str(tmp_path / "jog.npz")])
    assert (done.exit_code, "measured by a position" in done.output) == (1, True)


@pytest.mark.parametrize(("given", "problem"), [
    (["-o", "reach.txt"], "expected an ending of .rrd, .npz"),
    (["-o", "none/reach.npz"], "the folder does not exist"),
    (["-o", "reach.npz", "--url", "http://127.0.0.1:1"], "127.0.0.1:1"),
])  # fmt: skip
def test_mistakes(given, problem, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["record", "reach", *given])
    assert done.exit_code == 1
    assert problem in done.output


def test_an_absent_client_is_named(monkeypatch):
    monkeypatch.setattr(service.cli.record.importlib.util, "find_spec", lambda name: None)
    done = CliRunner().invoke(app, ["record", "reach", "-o", "a.npz"])
    assert (done.exit_code, "adverb-client" in done.output) == (1, True)
