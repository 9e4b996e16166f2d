"""Upload, versions, roll back, delete, refine: a real server that keeps a real store, with a real worker beside it."""

import asyncio
import json
from dataclasses import replace
from pathlib import Path

import pytest

from service.settings import Settings
from tests.service.catalog.conftest import JSON, OCTETS, PATIENCE_S, ZIP, Kept, client_of, until, zipped_arm
from tests.service.stream.conftest import open_stream
from verbs import library
from verbs.io import artifact

pytestmark = [pytest.mark.anyio]  # one server, whose verbs the tests change


@pytest.fixture(scope="module")
def arm_zip(tmp_path_factory):
    return zipped_arm(tmp_path_factory.mktemp("source"))


async def test_a_zip_becomes_a_verb_and_replaces_itself(client, arm_zip):
    first = await client.post("/v1/verbs", content=arm_zip, headers={"Content-Type": ZIP})
    assert first.status_code == 201, first.text
    number = first.json()["version"]
    assert (first.json()["verb"], first.headers["etag"]) == ("arm", f'"{number}"')
    assert (first.json()["author"], first.json()["reason"]) == ("a client", "upload")
    described = (await client.get("/v1/verbs/arm")).json()
    assert described["version"] == number
    pose = await client.post("/v1/verbs/arm/pose", json={"adverbs": {"x": 0.4, "y": 0.3}})
    assert pose.json()["version"] == number


async def test_if_match_keeps_two_authors_apart(client, tmp_path):
    first = await client.post("/v1/verbs", content=zipped_arm(tmp_path / "one", "first"), headers={"Content-Type": ZIP})
    now = first.json()["version"]
    other = zipped_arm(tmp_path / "two", "better")
    wrong = await client.post("/v1/verbs", content=other, headers={"Content-Type": ZIP, "If-Match": '"97"'})
    assert (wrong.status_code, wrong.json()["code"], wrong.json()["current"]) == (412, "version_conflict", now)
    right = await client.post("/v1/verbs", content=other, headers={"Content-Type": ZIP, "If-Match": f'"{now}"'})
    assert (right.status_code, right.json()["version"]) == (201, now + 1)
    for tag in (b"soon", b'"\xb2"'):  # the second is a digit to Python, and no number
        bad = await client.post("/v1/verbs", content=other, headers={b"Content-Type": ZIP.encode(), b"If-Match": tag})
        assert (bad.status_code, bad.json()["code"]) == (422, "bad_request")


async def test_two_uploads_at_once_come_one_after_the_other(client, tmp_path):
    async def both(what, **headers):
        files = []
        for k in range(2):
            artifact.save(
                replace(library.load("arm3"), name="raced", description=f"{what} {k}"), tmp_path / "raced.verb"
            )
            files.append((tmp_path / "raced.verb").read_bytes())
        headers = {"Content-Type": OCTETS, **headers}
        posts = [client.post("/v1/verbs", content=file, headers=headers) for file in files]
        answers = sorted(await asyncio.gather(*posts), key=lambda answer: answer.status_code)
        listed = (await client.get("/v1/verbs/raced/versions")).json()
        return answers, listed["current"], [row["version"] for row in listed["versions"]]

    answers, current, versions = await both("free")
    assert sorted(answer.json()["version"] for answer in answers) == [1, 2]
    assert (current, versions) == (2, [2, 1])
    (right, wrong), current, versions = await both("bound", **{"If-Match": '"2"'})
    assert (right.status_code, right.json()["version"]) == (201, 3)
    assert (wrong.status_code, wrong.json()["code"], wrong.json()["current"]) == (412, "version_conflict", 3)
    assert (current, versions) == (3, [3, 2, 1])
    assert (await client.get("/v1/verbs/raced")).json()["version"] == 3
    assert (await client.delete("/v1/verbs/raced")).status_code == 204


@pytest.mark.parametrize(
    ("content", "kind", "code"),
    [
        (b"", OCTETS, "bad_upload"),
        (b"noise" * 99, OCTETS, "bad_upload"),
        (b"PK\x03\x04", ZIP, "bad_upload"),
        (b"{}", JSON, "unsupported_media_type"),
    ],
)
async def test_an_invalid_upload_changes_nothing(client, kept, content, kind, code):
    answer = await client.post("/v1/verbs", content=content, headers={"Content-Type": kind})
    assert answer.json()["code"] == code
    assert str(kept.settings.data) not in answer.text
    assert not list((kept.settings.data / "uploads").iterdir())


async def test_a_verb_can_be_deleted_and_brought_back(client):
    assert (await client.delete("/v1/verbs/board", headers={"If-Match": '"9"'})).status_code == 412
    assert (await client.delete("/v1/verbs/board")).status_code == 204
    assert (await client.get("/v1/verbs/board")).json()["code"] == "unknown_verb"
    assert (await client.delete("/v1/verbs/board")).status_code == 404
    listed = (await client.get("/v1/verbs/board/versions")).json()
    assert (listed["current"], len(listed["versions"])) == (None, 1)
    assert (await client.post("/v1/verbs/board/versions/1/activate")).status_code == 200
    assert (await client.get("/v1/verbs/board")).json()["version"] == 1
    assert (await client.post("/v1/verbs/board/versions/8/activate")).json()["code"] == "unknown_version"


async def test_a_version_can_be_downloaded(client):
    artifact = await client.get("/v1/verbs/arm3/versions/1")
    assert artifact.content == Path(library.__file__).with_name("arm3.verb").read_bytes()
    same = await client.get("/v1/verbs/arm3/artifact?version=1")
    assert same.content == artifact.content
    assert (await client.get("/v1/verbs/arm3/artifact?version=9")).json()["code"] == "unknown_version"


async def test_a_refinement_is_followed_to_its_end_while_a_stream_runs(client, kept):
    async with open_stream(kept) as stream:
        await stream.open(1, "arm3", adverbs={"x": 0.4, "y": 0.3}, method="rbf")
        requested = {"max_pseudo": 25, "target_error": 0.0001}
        started = await client.post("/v1/verbs/arm3/refinements", json=requested)
        assert started.status_code == 202
        assert started.json()["request"].items() >= (requested | {"author": "a client"}).items()
        where = started.headers["location"]
        again = await client.post("/v1/verbs/arm3/refinements", json=requested)
        assert (again.status_code, again.json()["refinement"]) == (409, started.json()["id"])
        reading = asyncio.create_task(stream.until("version"))
        async with client.stream("GET", f"{where}/events") as following:
            assert following.headers["content-type"].startswith("text/event-stream")
            lines = [line async for line in following.aiter_lines()]
            events = [json.loads(line[6:]) for line in lines if line.startswith("data: ")]
        reply = await asyncio.wait_for(reading, PATIENCE_S)
        await stream.poses(3)
    last = events[-1]
    assert (last["state"], last["version_before"], last["version_after"]) == ("published", 1, 2)
    assert last["progress"]["pseudo"] == 25
    curve = [row[1] for row in last["progress"]["curve"]]
    assert curve[-1] < 0.3 * curve[0]
    assert reply["version"] == 2
    assert stream.frames[-1].of(1).version == 2
    sequences = [frame.sequence for frame in stream.frames]
    assert sequences == list(range(1, len(sequences) + 1))
    described = (await client.get("/v1/verbs/arm3")).json()
    assert described["version"] == 2
    assert "refined" in described["methods"]
    listed = (await client.get("/v1/refinements", params={"verb": "arm3"})).json()["refinements"]
    assert [row["id"] for row in listed] == [last["id"]]


async def test_a_refinement_for_quality_is_the_default_of_exact_verbs(client):
    started = await client.post("/v1/verbs/reach/refinements", json={"max_pseudo": 3})
    assert started.status_code == 202
    assert started.json()["request"]["for"] == "quality"
    ended = await until(client, started.headers["location"], lambda row: row["state"] not in ("queued", "running"))
    assert (ended["state"], ended["version_after"]) == ("published", 2)
    figures = ended["progress"]["figures"]
    assert figures["new"]["cost_mean"] < 0.95 * figures["now"]["cost_mean"]
    newest = (await client.get("/v1/verbs/reach/versions")).json()["versions"][0]
    assert newest["quality"] == figures
    await until(client, "/v1/verbs/reach", lambda row: row["version"] == 2)
    described = (await client.get("/v1/verbs/reach")).json()
    assert {row["for"] for row in described["pseudo_examples"]} == {"quality"}
    worst = figures["worst"][0]["adverbs"]
    for version in (1, 2):
        pose = {"adverbs": worst, "phase": 0.5, "version": version}
        answer = (await client.post("/v1/verbs/reach/pose", json=pose)).json()
        assert (answer["version"], answer["method"]) == (version, "corrected")
        assert answer["error"] < 1e-9
    wrong = await client.post("/v1/verbs/reach/refinements", json={"for": "quality", "target_error": 0.1})
    assert wrong.json()["code"] == "out_of_range"
    assert (await client.post("/v1/verbs/reach/versions/1/activate")).status_code == 200
    await until(client, "/v1/verbs/reach", lambda row: row["version"] == 1)


async def test_a_refinement_can_be_cancelled_and_its_worker_killed(client, kept):
    requested = {"max_pseudo": 2000, "target_error": 1e-6, "priority": 1}
    job = (await client.post("/v1/verbs/reach/refinements", json=requested)).json()
    where = f"/v1/refinements/{job['id']}"
    await until(client, where, lambda row: row["progress"].get("pseudo", 0) > 0)
    for worker in kept.workers.running.values():
        worker.kill()
    before = (await client.get(where)).json()["progress"]["pseudo"]
    await until(client, where, lambda row: row["progress"]["pseudo"] > before)
    await client.delete(where)
    ended = await until(client, where, lambda row: row["state"] == "cancelled")
    assert ended["version_after"] is None
    assert (await client.get("/v1/verbs/reach")).json()["version"] == 1


async def test_unknown_refinements_are_reported(client):
    for answer in (await client.get("/v1/refinements/unknown"), await client.delete("/v1/refinements/unknown")):
        assert (answer.status_code, answer.json()["code"]) == (404, "unknown_refinement")
    wrong = await client.post("/v1/verbs/arm3/refinements", json={"max_pseudo": -1})
    assert wrong.json()["code"] == "invalid_request"
    missing = await client.post("/v1/verbs/unknown/refinements", json={})
    assert missing.json()["code"] == "unknown_verb"


async def test_versions_survive_a_restart(tmp_path, arm_zip):
    for round_ in (1, 2):
        server = Kept(data=tmp_path, refiners=0).start(PATIENCE_S)
        try:
            async with client_of(server) as client:
                if round_ == 1:
                    await client.post("/v1/verbs", content=arm_zip, headers={"Content-Type": ZIP})
                    await client.delete("/v1/verbs/board")
                names = [row["name"] for row in (await client.get("/v1/verbs")).json()["verbs"]]
                assert names == sorted({"arm", *library.names()} - {"board"})
        finally:
            server.stop()


async def test_without_a_data_folder_nothing_can_be_changed(serve):
    with serve() as server:
        async with client_of(server) as client:
            for method, path in (
                ("POST", "/v1/verbs/arm3/refinements"),
                ("GET", "/v1/verbs/arm3/versions"),
                ("DELETE", "/v1/verbs/arm3"),
                ("GET", "/v1/refinements"),
            ):
                answer = await client.request(method, path, json={} if method == "POST" else None)
                assert (answer.status_code, answer.json()["code"]) == (409, "read_only")


def test_settings_reach_a_worker_by_its_environment(monkeypatch, tmp_path):
    settings = Settings(data=tmp_path, database_url="postgresql://somewhere/db", refiners=3, allow_public=True)
    for name, value in settings.environment().items():
        monkeypatch.setenv(name, value)
    assert Settings() == settings
