"""Streams that are open and idle need little memory, and leave nothing behind."""

import resource

import pytest

from benchmarks import idle


def test_idle_streams_need_less_than_40_kb_each():
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2 * 1_000 + idle.FILES:
        pytest.skip(f"the system allows {hard} open files only (ulimit -n)")
    found = idle.measure(1_000)
    assert found.kb_each < 40.0
    assert found.sockets_after <= found.sockets_before
