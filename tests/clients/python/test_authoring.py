"""Calls that change verbs, against a real server with a store, a worker and keys."""

from __future__ import annotations

from dataclasses import replace

import pytest
from adverb_client import AsyncClient, Client, TimedOut, errors

from service.access.keys import hash_of, new
from service.store.keys import open_keys
from tests.service.catalog.conftest import PATIENCE_S, Kept, zipped_arm
from tests.service.drafts.conftest import packed
from tests.verbs import raw_folder
from verbs import library
from verbs.io import artifact

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Address of a server, and a key with all scopes."""
    folder = tmp_path_factory.mktemp("authoring")
    store = open_keys(f"sqlite:///{folder / 'state.db'}")
    id, key = new()
    store.add(id, hash_of(key), name="studio", scopes=frozenset({"admin"}), expires_at_s=None)
    store.close()
    server = Kept(data=folder, refiners=1).start(PATIENCE_S)
    yield f"http://127.0.0.1:{server.port}", key
    server.stop()


@pytest.fixture
def client(served):
    address, key = served
    with Client(address, api_key=key) as client:
        yield client


def verb_file(folder, description: str) -> bytes:
    """A verb file that differs from others by its description."""
    path = folder / "arm.verb"
    artifact.save(replace(library.load("arm3"), name="arm", description=description), path)
    return path.read_bytes()


def test_versions_come_and_go(client, tmp_path):
    first = client.upload(verb_file(tmp_path, "one"), expected=0)
    assert (first.verb, first.number, first.current) == ("arm", 1, True)
    second = client.upload(verb_file(tmp_path, "two"))
    with pytest.raises(errors.VersionConflict):
        client.upload(verb_file(tmp_path, "three"), expected=1)
    assert [(row.number, row.current) for row in client.versions("arm")] == [(2, True), (1, False)]
    back = client.activate("arm", 1, expected=2)
    assert (back.number, back.current, back.sha256) == (1, True, first.sha256)
    assert client.verb("arm").description == "one"
    assert client.download("arm", 2) == verb_file(tmp_path, "two")
    assert second.size_bytes == len(client.download("arm", 2))
    with pytest.raises(errors.UnknownVersion):
        client.download("arm", 9)
    client.delete("arm")
    with pytest.raises(errors.UnknownVerb):
        client.verb("arm")
    found = client.changes("arm")
    assert [row.kind for row in found] == ["delete", "activate", "publish", "publish"]
    assert all("studio" in row.author for row in found)
    assert client.changes("arm", before=found[1].id, limit=1) == (found[2],)
    assert client.changes(author="another author") == ()


def test_a_source_is_built(client, tmp_path):
    assert client.upload(zipped_arm(tmp_path, "built")).source
    with pytest.raises(errors.BadUpload) as caught:
        client.upload(b"not a verb")
    assert caught.value.detail


def test_a_refinement_is_followed_to_its_end(client):
    job = client.refine("arm3", max_pseudo=1, aim="error", method="refined", budget_s=20.0)
    assert job.request["for"] == "error"
    seen = []
    ended = client.wait_refinement(job.id, progress=seen.append, timeout_s=PATIENCE_S)
    assert ended.ended
    assert ended.state in ("published", "not_better")
    assert seen[-1] == ended
    assert ended in client.refinements("arm3")
    assert list(client.follow_refinement(job.id))[-1] == ended
    assert client.cancel_refinement(job.id) == ended
    with pytest.raises(errors.UnknownRefinement):
        client.refinement("none")


def test_waiting_for_a_refinement_is_bounded(served, monkeypatch):
    address, key = served
    with Client(address, api_key=key) as client:
        job = client.refine("reach", budget_s=60.0)
        with pytest.raises(TimedOut, match=job.id):
            client.wait_refinement(job.id, timeout_s=0.0)
        client.cancel_refinement(job.id)
        assert client.wait_refinement(job.id, timeout_s=PATIENCE_S).state == "cancelled"


def test_a_draft_is_changed_and_published_and_gets_an_example(client, tmp_path):
    folder = raw_folder.write(tmp_path / "clips", raw_folder.reaches())
    last = sorted(folder.glob("*.bvh"))[-1]
    draft = client.create_draft(packed(folder, without=(last.name,)), name="drafted")
    assert (draft.name, draft.problem) == ("drafted", None)
    assert len(draft.clips) > 3
    changed = client.change_draft(draft.id, revision=draft.revision, description="from clips")
    assert changed.revision == draft.revision + 1
    assert 'description = "from clips"' in changed.toml
    with pytest.raises(errors.RevisionChanged):
        client.change_draft(draft.id, revision=draft.revision, description="late")
    assert draft.id in [row.id for row in client.drafts()]
    goal = {name: value for name, value in draft.clips[0]["adverbs"].items() if value is not None}
    pose = client.draft_pose(draft.id, goal, phase=0.5)
    assert (pose.version, pose.rotations.shape[1]) == (changed.revision, 4)
    motion = client.draft_sequence(draft.id, goal, fps=10)
    assert len(motion) == len(motion.times_s) > 3
    assert client.draft_motion(draft.id).startswith(b'{"joints":')
    published = client.publish_draft(draft.id, revision=changed.revision)
    assert published.verb == "drafted"
    assert client.draft(draft.id).revision == changed.revision
    client.delete_draft(draft.id)
    with pytest.raises(errors.UnknownDraft):
        client.draft(draft.id)
    added = client.add_example("drafted", last.read_bytes(), file=last.name, expected=published.number)
    assert (added.number, added.example["name"]) == (published.number + 1, last.stem)


async def test_calls_without_blocking(served, tmp_path):
    address, key = served
    async with AsyncClient(address, api_key=key) as client:
        access = await client.access()
        assert (access.required, access.name, access.scopes) == (True, "studio", ("admin",))
        version = await client.upload(verb_file(tmp_path, "asynchronous"))
        assert (await client.versions("arm"))[0].number == version.number
        await client.delete("arm", expected=version.number)
        job = await client.refine("jump", budget_s=60.0)
        await client.cancel_refinement(job.id)
        assert (await client.wait_refinement(job.id, timeout_s=PATIENCE_S)).state == "cancelled"
        assert (await client.changes("jump"))[0].kind == "cancel"
    async with AsyncClient(address, api_key="wrong") as client:
        with pytest.raises(errors.Unauthenticated):
            await client.upload(b"")


async def test_both_clients_have_the_same_calls():
    def calls(kind):
        return {name for name in dir(kind) if not name.startswith("_")}

    assert calls(Client) == calls(AsyncClient)
