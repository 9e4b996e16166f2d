"""Drafts by HTTP: made, read, changed, evaluated, published, deleted; what is refused and how."""

import asyncio
import io
import json
import zipfile

import numpy as np
import pytest

from tests.service.catalog.conftest import JSON, OCTETS, PATIENCE_S, ZIP, Kept, client_of
from tests.service.drafts.conftest import NAME, created, packed
from tests.service.faults.test_damage import flip
from tests.service.upload.test_building import damaged
from tests.verbs import raw_folder
from tests.verbs.sources import arm_source
from verbs.authoring.fit import build
from verbs.kernels import fk
from verbs.proposal.propose import propose, write
from verbs.runtime.evaluate import Evaluator

pytestmark = pytest.mark.anyio


def clip(draft, name):
    return next(row for row in draft["clips"] if row["name"] == name)


async def test_clips_become_a_draft_with_keytimes_adverbs_and_a_verb(client, draft, tmp_path):
    assert (draft["revision"], draft["name"], draft["measure"], draft["effector"]) == (
        *(1, NAME, "joint_position"),
        "RightHand",
    )
    assert draft["keytime_names"] == ["start", "apex", "end"]
    assert draft["problem"] is None
    assert sorted(row["name"] for row in draft["clips"]) == sorted(raw_folder.reaches())
    assert draft["created_at"] == draft["changed_at"] < draft["expires_at"]
    folder = raw_folder.write(tmp_path / NAME, raw_folder.reaches())
    proposal = propose(folder)
    for row in proposal.rows:
        own = clip(draft, row.file.removesuffix(".bvh"))
        np.testing.assert_allclose(own["keytimes"], row.keytimes.times, atol=1e-5)
        np.testing.assert_allclose(list(own["adverbs"].values()), row.values, atol=1e-4)
        assert (own["excluded"], own["readable"], own["set"]) == (False, True, False)
        assert own["left_out"] > 0.0
    write(proposal, folder)
    verb = build(folder).verb
    assert draft["verb"]["version"] == 1
    assert draft["verb"]["keytime_phases"] == verb.phases.tolist()
    assert [row["name"] for row in draft["verb"]["examples"]] == list(verb.examples)


async def test_it_is_listed_and_read_again(client, draft):
    listed = (await client.get("/v1/drafts")).json()
    row = listed["drafts"][0]
    assert listed["limit"] == 100
    assert (row["id"], row["revision"], row["name"], row["clips"], row["excluded"]) == (draft["id"], 1, NAME, 9, 0)
    assert row["built"]
    again = await client.get(f"/v1/drafts/{draft['id']}")
    assert again.json() == draft
    assert again.headers["etag"] == '"1"'
    same = await client.get(f"/v1/drafts/{draft['id']}", headers={"If-None-Match": '"1"'})
    assert (same.status_code, same.content) == (304, b"")


async def test_motions_are_poses_of_all_clips_in_their_own_time(client, draft):
    answer = await client.get(f"/v1/drafts/{draft['id']}/motion")
    assert answer.headers["content-type"] == OCTETS
    line, _, data = answer.content.partition(b"\n")
    head, numbers = json.loads(line), np.frombuffer(data, "<f4")
    assert (len(line) + 1) % 4 == 0
    assert len(numbers) == sum(row["samples"] for row in head["clips"]) * (3 + 4 * head["joints"])
    first = head["clips"][0]
    poses = numbers[: first["samples"] * (3 + 4 * head["joints"])].reshape(first["samples"], -1)
    motion = raw_folder.reaches()[first["name"]]
    assert (first["start"], first["end"]) == (0.0, pytest.approx(motion.duration_s))
    names, parents = head["skeleton"]["names"], np.array(head["skeleton"]["parents"])
    order = [motion.skeleton.index(name) for name in names]  # the file has another order
    for k, frame in ((0, 0), (len(poses) - 1, len(motion) - 1)):
        rotations = poses[k, 3:].reshape(1, -1, 4)
        _, found = fk.forward(poses[k : k + 1, :3], rotations, parents, np.array(head["skeleton"]["offsets"]))
        own, at = motion.skeleton, slice(frame, frame + 1)
        _, wanted = fk.forward(motion.root[at], motion.rotations[at], own.parents, own.offsets)
        np.testing.assert_allclose(found, wanted[:, order], atol=1e-4)
    tag = answer.headers["etag"]
    same = await client.get(f"/v1/drafts/{draft['id']}/motion", headers={"If-None-Match": tag})
    assert same.status_code == 304


async def test_a_moved_keytime_changes_the_verb_but_not_the_motions(client, draft):
    url, (start, apex, end) = f"/v1/drafts/{draft['id']}", clip(draft, "reach_3")["keytimes"]
    tag = (await client.get(f"{url}/motion")).headers["etag"]
    change = {"clips": {"reach_3": {"keytimes": [start, apex - 0.2, end]}}}
    answer = await client.patch(url, json=change, headers={"If-Match": '"1"'})
    assert answer.status_code == 200, answer.text
    changed = answer.json()
    assert (changed["revision"], answer.headers["etag"], changed["verb"]["version"]) == (2, '"2"', 2)
    own = clip(changed, "reach_3")
    assert own["keytimes"] == pytest.approx([start, apex - 0.2, end], abs=1e-5)
    assert (own["set"], own["confidence"], own["evidence"][1]) == (True, [1.0, 1.0, 1.0], "set")
    assert own["adverbs"] != clip(draft, "reach_3")["adverbs"]
    measured, before = clip(changed, "reach_2")["adverbs"], clip(draft, "reach_2")["adverbs"]
    assert measured == pytest.approx(before, abs=1e-9)
    assert changed["motion"] == draft["motion"]
    assert (await client.get(f"{url}/motion")).headers["etag"] == tag
    assert (await client.get(url)).json() == changed


async def test_clips_are_excluded_until_nothing_can_be_built_and_included_again(client, draft):
    url = f"/v1/drafts/{draft['id']}"
    names = [row["name"] for row in draft["clips"]]
    out = await client.patch(url, json={"clips": {name: {"excluded": True} for name in names[1:]}})
    assert out.status_code == 200
    assert (out.json()["verb"], out.json()["problem"]["code"]) == (None, "draft_not_built")
    assert "one example" in out.json()["problem"]["detail"]
    assert "/" not in out.json()["problem"]["detail"]
    assert clip(out.json(), names[1])["reason"] == "excluded by hand"
    for path in ("pose", "sequence"):
        pose = await client.post(f"{url}/{path}", json={"adverbs": {"x": 0.0, "y": 1.0, "z": 0.5}})
        assert (pose.status_code, pose.json()["code"]) == (409, "draft_not_built")
    published = await client.post(f"{url}/publish", json={})
    assert (published.status_code, published.json()["code"]) == (409, "draft_not_built")
    back = await client.patch(url, json={"clips": {name: {"excluded": False} for name in names[1:]}})
    assert back.json()["problem"] is None
    assert [row["adverbs"] for row in back.json()["clips"]] == [row["adverbs"] for row in draft["clips"]]


async def test_names_adverbs_and_styles_are_changed(client, draft):
    url, names = f"/v1/drafts/{draft['id']}", [row["name"] for row in draft["clips"]]
    adverbs = [
        {"name": "left"},
        {"name": "up", "unit": "cm"},
        {"description": "ahead"},
        {"name": "tired", "style": True},
    ]
    styles = {name: {"adverbs": {"tired": float(k % 2)}} for k, name in enumerate(names)}
    change = {"name": "other", "description": "By hand.", "keytime_names": ["a", "b", "c"], "adverbs": adverbs}
    changed = (await client.patch(url, json=change | {"clips": styles})).json()
    assert changed["problem"] is None
    assert [row["name"] for row in changed["adverbs"]] == ["left", "up", "z", "tired"]
    assert changed["adverbs"][3]["style"]
    own, before = clip(changed, names[1])["adverbs"], clip(draft, names[1])["adverbs"]
    assert (own["left"], own["up"], own["tired"]) == (
        *(pytest.approx(before["x"], abs=1e-6), pytest.approx(100 * before["y"], abs=1e-4)),
        1.0,
    )
    assert changed["verb"]["name"] == changed["name"] == "other"
    assert changed["verb"]["description"] == "By hand."
    assert changed["verb"]["keytime_names"] == ["a", "b", "c"]


async def test_mends_are_offered_and_switched(client, tmp_path):
    folder = raw_folder.awkward_folder(tmp_path / "awkward")
    made = await created(client, packed(folder, prefix="awkward/"))
    url = f"/v1/drafts/{made['id']}"
    assert made["name"] == "awkward"
    for file, part in raw_folder.AWKWARD.items():
        own = clip(made, file.removesuffix(".bvh"))
        assert own["excluded"]
        assert part in own["problem"] + own["reason"]
    (spin,) = [row for row in clip(made, "spinning")["mends"] if row["kind"] == "spin"]
    assert (spin["joint"], spin["apply"]) == ("RightHand", True)
    assert "spins" in spin["text"]
    wrong = await client.patch(url, json={"clips": {"truncated": {"excluded": False}}})
    assert (wrong.status_code, wrong.json()["code"]) == (422, "invalid_draft")
    switch = {"mends": [{"index": spin["index"], "apply": False}]}
    changed = (await client.patch(url, json={"clips": {"spinning": switch}})).json()
    assert not clip(changed, "spinning")["mends"][spin["index"]]["apply"]
    assert changed["motion"] != made["motion"]
    assert "apply = false" in changed["toml"]
    assert "rotates joint 'RightHand' 360°" in changed["problem"]["detail"]
    added = {"mends": [{"index": spin["index"]}, {"kind": "idle", "start": 0.2, "end": 2.0}]}
    trimmed = (await client.patch(url, json={"clips": {"spinning": added}})).json()
    assert trimmed["problem"] is None
    assert (clip(trimmed, "spinning")["start"], clip(trimmed, "spinning")["end"]) == (
        pytest.approx(0.2, abs=0.05),
        pytest.approx(2.0, abs=0.05),
    )
    assert (await client.delete(url)).status_code == 204


async def test_keytimes_at_the_ends_follow_a_trim_and_come_back(client, draft):
    url, before = f"/v1/drafts/{draft['id']}", clip(draft, "reach_3")
    apex = before["keytimes"][1]
    trim = {"kind": "idle", "start": apex - 0.3, "end": apex + 0.3}
    own = clip((await client.patch(url, json={"clips": {"reach_3": {"mends": [trim]}}})).json(), "reach_3")
    assert own["keytimes"] == pytest.approx([own["start"], apex, own["end"]])
    assert own["start"] > before["start"]
    assert own["end"] < before["end"]
    moved = {"keytimes": [own["start"], apex + 0.05, own["end"]]}
    assert (await client.patch(url, json={"clips": {"reach_3": moved}})).status_code == 200
    undone = {"mends": [{"index": own["mends"][-1]["index"], "apply": False}]}
    again = clip((await client.patch(url, json={"clips": {"reach_3": undone}})).json(), "reach_3")
    assert again["keytimes"] == pytest.approx([before["start"], apex + 0.05, before["end"]])


async def test_a_further_proposal_keeps_what_was_decided(client, draft):
    url, (start, apex, end) = f"/v1/drafts/{draft['id']}", clip(draft, "reach_3")["keytimes"]
    clips = {"reach_3": {"keytimes": [start, apex + 0.05, end]}, "reach_5": {"excluded": True}}
    changed = (await client.patch(url, json={"clips": clips, "propose": True})).json()
    assert clip(changed, "reach_3")["keytimes"] == pytest.approx([start, apex + 0.05, end])
    assert clip(changed, "reach_5")["excluded"]
    assert "aligned with 1 annotated clip" in clip(changed, "reach_1")["evidence"][1]
    other = (await client.patch(url, json={"effector": "LeftHand"})).json()
    assert other["effector"] == "LeftHand"
    assert clip(other, "reach_5")["reason"] == "excluded by hand"


async def test_poses_and_sequences_are_those_of_the_verb(client, draft, tmp_path):
    folder = raw_folder.write(tmp_path / NAME, raw_folder.reaches())
    write(propose(folder), folder)
    evaluator = Evaluator(build(folder).verb)
    adverbs = clip(draft, "reach_4")["adverbs"] | {"y": 1.0}
    url = f"/v1/drafts/{draft['id']}"
    pose = (await client.post(f"{url}/pose", json={"adverbs": adverbs, "phase": 0.5})).json()
    wanted = evaluator.pose(adverbs, phase=0.5)
    assert (pose["verb"], pose["version"]) == (NAME, 1)
    np.testing.assert_allclose(pose["rotations"], wanted.rotations[0], atol=1e-4)
    binary = await client.post(f"{url}/pose", json={"adverbs": adverbs, "phase": 0.5}, headers={"Accept": OCTETS})
    assert binary.headers["content-type"] == OCTETS
    motion = (await client.post(f"{url}/sequence", json={"adverbs": adverbs, "fps": 30})).json()
    assert len(motion["rotations"]) == motion["frames"] > 60
    wrong = await client.post(f"{url}/pose", json={"adverbs": adverbs, "version": 1})
    assert (wrong.status_code, wrong.json()["code"]) == (422, "bad_request")
    metrics = (await client.get("/metrics")).text
    assert f'verb="{NAME}"' not in metrics  # names of drafts are no labels


async def test_poses_of_a_draft_are_refused_once_its_artifact_is_damaged(kept, client, draft):
    goal, url = {"adverbs": clip(draft, "reach_4")["adverbs"], "phase": 0.5}, f"/v1/drafts/{draft['id']}/pose"
    before = (await client.post(url, json=goal)).json()  # and is cached
    drafts = kept.state.store_sync.store.drafts
    path = drafts.path(drafts.get(draft["id"]).artifact)
    content = path.read_bytes()
    flip(path)
    refused = await client.post(url, json=goal)
    assert (refused.status_code, refused.json()["code"]) == (500, "artifact_damaged")
    path.write_bytes(content)
    assert (await client.post(url, json=goal)).json() == before


async def test_a_draft_is_published_with_its_source(client, draft):
    url = f"/v1/drafts/{draft['id']}"
    answer = await client.post(f"{url}/publish", json={"name": "published"}, headers={"If-Match": '"1"'})
    assert answer.status_code == 201, answer.text
    first = answer.json()
    assert (first["verb"], first["version"], first["current"], first["source"]) == ("published", 1, True, True)
    assert answer.headers["location"] == "/v1/verbs/published"
    served = (await client.get("/v1/verbs/published")).json()
    same = ("examples", "keytime_phases", "domain", "skeleton", "measure", "contacts")
    for key in same:
        assert served[key] == draft["verb"][key], key
    assert (await client.get(url)).json() == draft
    await client.patch(url, json={"clips": {"reach_0": {"excluded": True}}})
    second = await client.post(f"{url}/publish", json={"name": "published"})
    assert (second.status_code, second.json()["version"]) == (201, 2)
    assert len((await client.get("/v1/verbs/published")).json()["examples"]) == 8
    old = await client.post(f"{url}/publish", json={}, headers={"If-Match": '"1"'})
    assert (old.status_code, old.json()["code"], old.json()["current"]) == (412, "revision_changed", 2)


async def test_of_two_changes_at_once_one_is_refused(client, draft):
    url = f"/v1/drafts/{draft['id']}"
    changes = [{"clips": {f"reach_{k}": {"excluded": True}}} for k in (1, 2)]
    answers = await asyncio.gather(*(client.patch(url, json=change) for change in changes))
    right, wrong = sorted(answers, key=lambda answer: answer.status_code)
    assert (right.status_code, right.json()["revision"]) == (200, 2)
    assert (wrong.status_code, wrong.json()["code"], wrong.json()["current"]) == (412, "revision_changed", 2)
    assert (await client.get(url)).json() == right.json()
    for given in ('"1"', '"7"'):
        old = await client.patch(url, json={"description": "x"}, headers={"If-Match": given})
        assert (old.status_code, old.json()["code"]) == (412, "revision_changed")
        gone = await client.delete(url, headers={"If-Match": given})
        assert gone.status_code == 412
    bad = await client.patch(url, json={}, headers={"If-Match": "soon"})
    assert (bad.status_code, bad.json()["code"]) == (422, "bad_request")


@pytest.mark.parametrize(
    ("change", "at", "problem"),
    [
        ({"clips": {"nope": {"excluded": True}}}, "clips.nope", "no clip"),
        ({"clips": {"reach_1": {"keytimes": [0.0, 1.0]}}}, "clips.reach_1.keytimes", "2 keytimes"),
        ({"clips": {"reach_1": {"keytimes": []}}}, "clips.reach_1.keytimes", "0 keytimes"),
        ({"clips": {"reach_1": {"keytimes": [0.0, 2.0, 1.0]}}}, "clips.reach_1.keytimes", "must rise"),
        ({"clips": {"reach_1": {"keytimes": [0.0, 1.0, 900.0]}}}, "clips.reach_1.keytimes", "must lie"),
        ({"clips": {"reach_1": {"adverbs": {"x": 0.5}}}}, "clips.reach_1.adverbs.x", "no style adverb"),
        ({"clips": {"reach_1": {"mends": [{"index": 99}]}}}, "clips.reach_1.mends.0.index", "less than"),
        ({"clips": {"reach_1": {"mends": [{"kind": "magic"}]}}}, "clips.reach_1.mends.0.kind", "one of"),
        ({"clips": {"reach_1": {"mends": [{"kind": "idle", "start": 1.0}]}}}, "clips.reach_1.mends.0", "both"),
        ({"clips": {"reach_1": {"mends": [{"kind": "spin", "joint": "Tail"}]}}}, "clips.reach_1.mends", "Tail"),
        ({"adverbs": [{"name": "x"}]}, "adverbs", "list all 3"),
        ({"adverbs": [{}, {}, {"name": "x"}]}, "adverbs", "must differ"),
        ({"adverbs": [{}, {"unit": "furlong"}, {}]}, "adverbs.1.unit", "one of"),
        ({"adverbs": [{}, {}, {}, {"name": "w"}]}, "adverbs.3", "style"),
        ({"keytime_names": ["a"]}, "keytime_names", "1 names for 3"),
        ({"keytime_names": ["a", "a", "b"]}, "keytime_names", "different"),
        ({"effector_keytime_index": 3}, "effector_keytime_index", "0 to 2"),
        ({"effector": "Tail"}, "effector", "one of"),
        ({"measure": "taste"}, "measure", "one of"),
    ],
)
async def test_values_that_cannot_be_stored_are_named(client, draft, change, at, problem):
    url = f"/v1/drafts/{draft['id']}"
    answer = await client.patch(url, json=change)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_draft"), answer.text
    assert answer.json()["errors"][0]["at"] == at
    assert problem in answer.json()["errors"][0]["problem"]
    assert (await client.get(url)).json() == draft


@pytest.mark.parametrize(
    ("content", "status", "code"),
    [
        (b"", 400, "malformed_body"),
        (b"[]", 422, "invalid_request"),
        (b"{", 400, "malformed_body"),
        (b'{"clips": {"reach_1": {"keytimes": [0, NaN, 1]}}}', 422, "invalid_request"),
        (b'{"clips": {"reach_1": {"keytimes": [0, 1e999, 1]}}}', 422, "invalid_request"),
        (b'{"name": "No Name"}', 422, "invalid_request"),
        (b'{"nmae": "x"}', 422, "invalid_request"),
        (b'{"description": "' + b"x" * 2_000_000 + b'"}', 413, "body_too_large"),
        (b'{"clips": ' + b"[" * 100_000, 400, "malformed_body"),
    ],
)
async def test_bodies_that_are_no_change_are_refused(client, draft, content, status, code):
    url = f"/v1/drafts/{draft['id']}"
    answer = await client.patch(url, content=content, headers={"Content-Type": JSON})
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert (await client.get(url)).json()["revision"] == 1


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"", "unpacked"),
        (b"noise" * 100, "unpacked"),
        (damaged(8, b"\x61\x00"), "another method than deflate"),
        (damaged(6, b"\x01\x00"), "unpacked"),
        (damaged(39, b"\xff\xff\xff\xff"), "unpacked"),
    ],
)
async def test_archives_that_cannot_be_read_are_refused(client, content, part):
    before = (await client.get("/v1/drafts")).json()
    answer = await client.post("/v1/drafts", content=content, headers={"Content-Type": ZIP})
    assert (answer.status_code, answer.json()["code"]) == (422, "bad_upload")
    assert part in answer.json()["detail"]
    assert (await client.get("/v1/drafts")).json() == before


async def test_folders_without_clips_are_refused_with_the_reason(client, tmp_path):
    cases = {
        "no motion files": {"readme.txt": "hello"},
        "several folders": {"a/one.bvh": "x", "b/two.bvh": "x"},
        "no clip can be used": {"one.bvh": "noise", "two.bvh": "HIERARCHY"},
        "several: ": {"a/verb.toml": "", "b/verb.toml": ""},
    }
    for k, (part, files) in enumerate(cases.items()):
        folder = tmp_path / str(k)
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)
        content = _zip_of(folder)
        answer = await client.post("/v1/drafts", content=content, headers={"Content-Type": ZIP})
        assert (answer.status_code, answer.json()["code"]) == (422, "bad_upload"), part
        assert part in answer.json()["detail"]
        assert "uploads" not in answer.json()["detail"]


def _zip_of(folder):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(folder).as_posix())
    return content.getvalue()


async def test_wrong_options_are_refused(client, reaches):
    cases = [
        ({"name": "No Name"}, "invalid_request"),
        ({"effector": "Tail"}, "bad_upload"),
        ({"measure": "taste"}, "bad_upload"),
        ({"unit": "furlong"}, "bad_upload"),
        ({"annotated": "reach_1.bvh"}, "bad_request"),
        ({"annotated": "reach_1.bvh@0,nan,1"}, "bad_request"),
        ({"annotated": "nope.bvh@0,1,2"}, "bad_upload"),
    ]
    for query, code in cases:
        answer = await client.post("/v1/drafts", content=reaches, headers={"Content-Type": ZIP}, params=query)
        assert (answer.status_code, answer.json()["code"]) == (422, code), query
    wrong = await client.post("/v1/drafts", content=reaches, headers={"Content-Type": JSON})
    assert (wrong.status_code, wrong.json()["code"]) == (415, "unsupported_media_type")


async def test_a_draft_may_come_with_its_verb_toml(client, tmp_path):
    folder = arm_source(tmp_path / "arm")
    made = await created(client, packed(folder))
    assert (made["name"], made["problem"]) == ("arm", None)
    assert all(row["set"] and row["evidence"] == ["given"] * 3 for row in made["clips"])
    assert made["verb"]["examples"] == (await _described(client, folder))["examples"]
    await client.delete(f"/v1/drafts/{made['id']}")


async def _described(client, folder):
    await client.post("/v1/verbs", content=packed(folder), headers={"Content-Type": ZIP})
    return (await client.get("/v1/verbs/arm")).json()


@pytest.mark.parametrize("method", ["GET", "PATCH", "DELETE"])
async def test_unknown_drafts_are_404(client, method):
    for id in ("0000000000000000", "..%2F..%2Fetc", "é", "a" * 32):
        answer = await client.request(method, f"/v1/drafts/{id}", json={} if method == "PATCH" else None)
        assert (answer.status_code, answer.json()["code"]) in ((404, "unknown_draft"), (404, "not_found"))


async def test_pages_of_other_sites_and_other_hosts_are_refused(client, draft, reaches):
    url = f"/v1/drafts/{draft['id']}"
    foreign = {"Origin": "https://elsewhere.example"}
    calls = [
        client.post("/v1/drafts", content=reaches, headers={"Content-Type": ZIP, **foreign}),
        client.patch(url, json={"description": "x"}, headers=foreign),
        client.post(f"{url}/publish", json={}, headers=foreign),
        client.delete(url, headers=foreign),
        client.post("/v1/verbs/reach/examples", params={"file": "a.bvh"}, content=b"", headers=foreign),
    ]
    for call in calls:
        answer = await call
        assert (answer.status_code, answer.json()["code"]) == (403, "foreign_origin")
    answer = await client.get(url, headers={"Host": "elsewhere.example"})
    assert (answer.status_code, answer.json()["code"]) == (421, "unknown_host")
    assert (await client.get(url)).json() == draft


async def test_the_number_of_drafts_is_bounded(reaches, tmp_path, anyio_backend):
    server = Kept(data=tmp_path, refiners=0, max_drafts=1).start(PATIENCE_S)
    try:
        async with client_of(server) as client:
            made = await created(client, reaches)
            full = await client.post("/v1/drafts", content=reaches, headers={"Content-Type": ZIP})
            assert (full.status_code, full.json()["code"], full.json()["limit"]) == (409, "too_many_drafts", 1)
            assert (await client.delete(f"/v1/drafts/{made['id']}")).status_code == 204
            assert (await client.get("/v1/drafts")).json() == {"limit": 1, "drafts": []}
            assert list((tmp_path / "uploads").iterdir()) == []
    finally:
        server.stop()
