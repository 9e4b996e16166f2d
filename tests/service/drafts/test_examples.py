"""One more example for a verb: from the stored source of an upload or a draft, or from that of a built-in verb."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest

from tests.service.catalog.conftest import JSON, OCTETS, ZIP
from tests.service.drafts.conftest import packed
from tests.verbs.sources import arm_motion, arm_source, hand
from verbs import library
from verbs.authoring.fit import build
from verbs.io import artifact, bvh

pytestmark = pytest.mark.anyio


@pytest.fixture
def clip(tmp_path):
    """A reach of the arm with its hand where no example has it."""
    bvh.write(arm_motion(0.6, 1.1, frames=51), tmp_path / "f.bvh", decimals=9)
    return (tmp_path / "f.bvh").read_bytes()


@pytest.fixture
async def arm(client, tmp_path):
    """The arm, uploaded with its source."""
    answer = await client.post("/v1/verbs", content=packed(arm_source(tmp_path / "arm")), headers={"Content-Type": ZIP})
    assert answer.status_code == 201, answer.text
    assert answer.json()["source"]
    yield answer.json()
    await client.delete("/v1/verbs/arm")


async def add(client, content, verb="arm", headers=None, **query):
    return await client.post(
        f"/v1/verbs/{verb}/examples", content=content, params=query, headers={"Content-Type": OCTETS, **(headers or {})}
    )


async def test_a_clip_is_added_with_proposed_keytimes_and_measured_adverbs(client, arm, clip):
    answer = await add(client, clip, file="f.bvh", headers={"If-Match": f'"{arm["version"]}"'})
    assert answer.status_code == 201, answer.text
    found = answer.json()
    assert (found["verb"], found["version"], found["current"], found["source"]) == (
        "arm",
        arm["version"] + 1,
        True,
        True,
    )
    example = found["example"]
    assert example["name"] == "f"
    assert example["keytimes"] == pytest.approx([0.0, 25 / 30, 50 / 30], abs=0.07)
    assert all(0.0 < sure <= 1.0 for sure in example["confidence"])
    np.testing.assert_allclose(list(example["adverbs"].values()), hand(0.6, 1.1), atol=0.02)
    described = (await client.get("/v1/verbs/arm")).json()
    assert described["version"] == found["version"]
    assert [row["name"] for row in described["examples"]][-1] == "f"
    assert described["examples"][-1]["adverbs"] == example["adverbs"]
    again = await add(client, clip, file="f.bvh")
    assert (again.status_code, again.json()["code"]) == (422, "invalid_draft")
    assert "already" in again.json()["errors"][0]["problem"]


async def test_keytimes_may_be_given(client, arm, clip):
    found = (await add(client, clip, file="g.bvh", keytimes="0,0.8,1.6")).json()
    assert found["example"]["keytimes"] == [0.0, 0.8, 1.6]
    assert found["example"]["confidence"] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("query", "code", "at"),
    [
        ({"file": "../f.bvh"}, "invalid_draft", "file"),
        ({"file": ".bvh"}, "invalid_draft", "file"),
        ({"file": "f.exe"}, "invalid_draft", "file"),
        ({"file": "a.bvh"}, "invalid_draft", "file"),
        ({"file": "f.bvh", "keytimes": "0,1"}, "invalid_draft", "keytimes"),
        ({"file": "f.bvh", "keytimes": "0,1,99"}, "invalid_draft", "keytimes"),
        ({"file": "f.bvh", "keytimes": "0,nan,1"}, "bad_request", None),
        ({"file": "f.bvh", "keytimes": "soon"}, "bad_request", None),
        ({"file": "f.bvh", "style": "tired:0.5"}, "invalid_draft", "style"),
        ({"file": "f.bvh", "style": "tired"}, "bad_request", None),
        ({}, "invalid_request", "query.file"),
    ],
)
async def test_wrong_names_keytimes_and_styles_are_refused(client, arm, clip, query, code, at):
    answer = await add(client, clip, **query)
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text
    if at:
        assert answer.json()["errors"][0]["at"] == at
    assert (await client.get("/v1/verbs/arm")).json()["version"] == arm["version"]


async def test_clips_that_cannot_be_used_are_refused(client, arm, clip):
    for content in (b"", b"noise" * 50, clip[: len(clip) // 2], clip.replace(b"Lower", b"Middle")):
        answer = await add(client, content, file="f.bvh")
        assert (answer.status_code, answer.json()["code"]) == (422, "bad_upload")
        assert "uploads" not in answer.json()["detail"]
    wrong = await client.post("/v1/verbs/arm/examples", params={"file": "f.bvh"}, headers={"Content-Type": JSON})
    assert (wrong.status_code, wrong.json()["code"]) == (415, "unsupported_media_type")
    old = await add(client, clip, file="f.bvh", headers={"If-Match": '"97"'})
    assert (old.status_code, old.json()["code"], old.json()["current"]) == (412, "version_conflict", arm["version"])
    unknown = await add(client, clip, verb="nope", file="f.bvh")
    assert (unknown.status_code, unknown.json()["code"]) == (404, "unknown_verb")


async def test_a_verb_without_a_source_is_refused(client, clip, tmp_path):
    artifact.save(replace(library.load("arm3"), name="bare"), tmp_path / "bare.verb")
    content = (tmp_path / "bare.verb").read_bytes()
    uploaded = await client.post("/v1/verbs", content=content, headers={"Content-Type": OCTETS})
    assert uploaded.json()["source"] is False
    answer = await add(client, clip, verb="bare", file="f.bvh")
    assert (answer.status_code, answer.json()["code"]) == (409, "no_source")


async def test_an_example_of_a_built_in_verb_is_added_to_its_packaged_source(client, clip):
    folder = library.source("arm3")
    first = sorted(folder.glob("*.bvh"))[0]
    before = (await client.get("/v1/verbs/arm3")).json()
    added = await add(client, first.read_bytes(), verb="arm3", file="twin.bvh")
    assert added.status_code == 201, added.text
    assert added.json()["version"] == before["version"] + 1
    after = (await client.get("/v1/verbs/arm3")).json()
    assert [row["name"] for row in after["examples"]] == [*(row["name"] for row in before["examples"]), "twin"]
    twin = added.json()["example"]["adverbs"]
    assert twin == pytest.approx(
        next(row for row in before["examples"] if row["name"] == first.stem)["adverbs"], abs=0.02
    )
    assert not (folder / "twin.bvh").exists()


async def test_the_stored_source_builds_the_version(client, arm, clip, kept, tmp_path):
    number = (await add(client, clip, file="f.bvh", keytimes="0,0.8,1.6")).json()["version"]
    store = kept.state.store_sync.store
    with zipfile.ZipFile(store.source(store.version("arm", number))) as archive:
        archive.extractall(tmp_path / "again")
    made = build(tmp_path / "again")
    assert made.warnings == ()
    artifact.save(made.verb, tmp_path / "again.verb")
    assert (tmp_path / "again.verb").read_bytes() == (await client.get(f"/v1/verbs/arm/versions/{number}")).content
