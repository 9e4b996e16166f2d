"""A parent without threads: children start clean, their ends are collected, timers and sockets call back."""

import subprocess
import sys
import textwrap
import time

import pytest

from tests.warm import lives

LONGEST_S = 60.0


@pytest.fixture
def script():
    """Runs a script in a process of its own, since the one of pytest has threads; its standard output."""

    def run(text: str) -> str:
        head = "import os, signal, socket, sys, threading, time\nfrom service.run.fork import *\nparent = Parent()\n"
        command = [sys.executable, "-c", head + textwrap.dedent(text)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_exit_codes_and_signals_are_reported(script):
    assert (
        script("""
        runs = [lambda: None, lambda: 3, lambda: sys.exit(4), lambda: sys.exit("no"), lambda: 1 / 0,
                lambda: os.kill(os.getpid(), signal.SIGKILL)]
        for run in runs:
            codes = []
            child = parent.fork(run, name="child", on_end=codes.append)
            while not codes:
                parent.turn()
            assert child.code == codes[0]
            child.signal(signal.SIGTERM)
            print(codes[0], end=" ", flush=True)
    """)
        == "0 3 4 1 1 -9 "
    )


def test_a_child_starts_clean(script):
    assert (
        script("""
        signal.signal(signal.SIGTERM, lambda *_: print("the parent's handler"))
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
        extra, kept = os.open("/dev/null", os.O_RDONLY), os.open("/dev/null", os.O_RDONLY)
        parent.later(1000.0, print)

        def run():
            assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
            assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL
            assert signal.set_wakeup_fd(-1) == -1
            assert not signal.pthread_sigmask(signal.SIG_BLOCK, ())
            assert os.getsid(0) == os.getpid()
            listed = [int(fd) for fd in os.listdir("/proc/self/fd")]
            assert [fd for fd in listed if os.path.exists(f"/proc/self/fd/{fd}")] == [0, 1, 2, kept], listed
            assert open("/proc/self/comm").read() == "a-name\\n"

        codes = []
        parent.fork(run, name="a-name", keep=[kept], on_end=codes.append)
        while not codes:
            parent.turn()
        print(codes)
    """)
        == "[0]\n"
    )


def test_a_process_with_threads_is_not_forked(script):
    assert (
        script("""
        event = threading.Event()
        thread = threading.Thread(target=event.wait)
        thread.start()
        try:
            parent.fork(lambda: print("forked"), name="child", on_end=print)
        except TooManyThreads:
            print("refused")
        event.set()
    """)
        == "refused\n"
    )


def test_timers_and_sockets_call_back_in_order(script):
    assert (
        script("""
        mine, its = socket.socketpair()
        parent.watch(mine, lambda: (print(mine.recv(10).decode()), parent.forget(mine)))
        parent.later(0.02, lambda: its.send(b"socket"))
        parent.later(0.01, lambda: print("timer"))
        while mine.fileno() != -1:
            parent.turn()
        parent.close()
    """)
        == "timer\nsocket\n"
    )


def test_a_child_ends_with_its_parent(script):
    text = script("""
        child = parent.fork(lambda: time.sleep(600), name="child", on_end=print)
        print(child.pid, flush=True)
    """)
    end = time.monotonic() + LONGEST_S
    while lives(int(text)):
        assert time.monotonic() < end
        time.sleep(0.01)
