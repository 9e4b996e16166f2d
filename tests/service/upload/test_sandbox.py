"""A sandbox forks, and its limits hold: the server answers after any job and continues."""

import errno
import json
import subprocess
import time

import pytest

from tests.service.upload import hostile
from tests.warm import children, descendants, lives

LONGEST_S = 60.0
KILLED = "reading it takes more memory or time than an upload may, or broke the process that does"
TARGET = "tests.service.upload.hostile:main"


@pytest.fixture
def run(warm, tmp_path):
    """Start a server whose uploads are hostile jobs; all processes are ended with the test."""
    started = []

    def begin(*jobs):
        paths = [tmp_path / f"upload{number}" for number, _ in enumerate(jobs)]
        for path, job in zip(paths, jobs, strict=True):
            path.write_text(job)
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        started.append(warm.start(*map(str, paths), target=TARGET, **pipes))
        return started[-1], paths

    yield begin
    for process in started:
        process.end()


def errors(run, *jobs):
    """What the server answers for each upload; the parent continues after each, and logs nothing of the sandbox."""
    process, _ = run(*jobs)
    lines = process.stdout.read().decode().splitlines()
    assert process.wait(LONGEST_S) == 0, process.stderr.read()
    return dict(line.split("\t") for line in lines)


def ends(pid):
    """Wait for the end of a process."""
    end = time.monotonic() + LONGEST_S
    while lives(pid):
        assert time.monotonic() < end
        time.sleep(0.01)


def test_memory_is_limited_in_addition_to_what_the_fork_maps(run, tmp_path):
    assert errors(run, "memory") == {"memory": "MemoryError"}
    assert (tmp_path / "upload0.verb").read_text() == str(hostile.MEMORY_BYTES // 2)


@pytest.mark.parametrize("job", ["cpu", "crash", "long"])
def test_a_sandbox_that_is_killed_is_a_bad_upload(run, job):
    assert errors(run, job, "noise") == {job: KILLED, "noise": "read b''"}


def test_a_sandbox_that_hangs_is_killed(run, tmp_path, monkeypatch):
    monkeypatch.setenv("LONGEST_S", "2")
    assert errors(run, "hang", "noise") == {"hang": "it takes longer than 2 s", "noise": "read b''"}
    ends(int((tmp_path / "upload0.verb").read_text()))


def test_files_are_limited(run, tmp_path):
    assert errors(run, "file") == {"file": f"OSError {errno.EFBIG}"}
    assert (tmp_path / "upload0.verb").stat().st_size <= hostile.FILE_BYTES


def test_its_standard_streams_are_discarded(run):
    process, _ = run("noise")
    assert process.stdout.read() == b"noise\tread b''\n"
    assert process.wait(LONGEST_S) == 0
    assert process.stderr.read() == b""


def test_it_inherits_one_socket_and_nothing_else(run):
    found = json.loads(errors(run, "files")["files"])
    assert found["session"]
    kinds = sorted(target.partition(":")[0] for target in found["files"].values())
    assert kinds == ["/dev/null"] * 3 + ["socket"]


def test_ten_uploads_in_a_row_need_ten_forks_and_no_start(run):
    process, _ = run(*["lineage"] * 10)
    rows = [json.loads(line.split(b"\t")[1]) for line in process.stdout.read().splitlines()]
    assert process.wait(LONGEST_S) == 0
    assert len({row["pid"] for row in rows}) == 10
    assert all(row["forked"] and row["parent"] == process.pid for row in rows)


@pytest.mark.parametrize("which", ["server", "parent"])
def test_it_ends_with_the_server_and_with_the_parent(run, which):
    process, (path,) = run("hang")
    end = time.monotonic() + LONGEST_S
    result = path.with_suffix(".verb")
    while not (result.exists() and result.read_text()):
        assert time.monotonic() < end
        time.sleep(0.01)
    (server,) = children(process.pid, "adverb-server")
    (box,) = children(process.pid, "adverb-sandbox")
    assert descendants(process.pid) == [server, box]
    hostile.os.kill(server if which == "server" else process.pid, hostile.signal.SIGKILL)
    ends(box)
