"""The evaluator of the TypeScript client, in Node, against a server."""

from __future__ import annotations

from tests.clients.python.served import serve
from tests.clients.typescript.node import run


def test_a_thousand_random_poses_are_those_of_the_server(all_verbs):
    with serve(all_verbs) as address:
        found = run("evaluate.mjs", address, "1000")
    assert found["poses"] >= 1_000
    assert set(found["worst"]) == set(all_verbs.entries)
    assert max(found["worst"].values()) <= 1e-5, found["worst"]
