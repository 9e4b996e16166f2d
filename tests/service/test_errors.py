"""Every bad request gets a problem: the right status, a stable code, and what is allowed."""

import asyncio

import httpx
import numpy as np
import pytest
from starlette.requests import ClientDisconnect

from service import errors, state
from tests.service.conftest import ARM, SWAY, app_of, client_of
from verbs.errors import RequestError, UnknownName, VerbError

pytestmark = pytest.mark.anyio

JSON = {"Content-Type": "application/json"}


def problem(answer: httpx.Response, status: int, code: str) -> dict:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    reply = answer.json()
    assert reply["code"] == code
    assert reply["status"] == status
    assert reply["type"] == f"/docs#{code}"
    assert reply["title"] == errors.PROBLEMS[code].title
    assert reply["detail"]
    assert answer.headers["x-request-id"]
    return reply


async def post(client, verb="arm3", route="pose", **body) -> httpx.Response:
    return await client.post(f"/v1/verbs/{verb}/{route}", json=body)


async def test_an_unknown_verb_names_the_known_ones(client, catalog):
    for answer in (await client.get("/v1/verbs/nope"), await post(client, verb="nope", adverbs=ARM)):
        assert problem(answer, 404, "unknown_verb")["known"] == list(catalog.entries)


async def test_an_unknown_version_names_the_known_one(client):
    assert problem(await post(client, adverbs=ARM, version=9), 404, "unknown_version")["known"] == ["1"]


async def test_an_unknown_adverb_names_the_known_ones(client):
    reply = problem(await post(client, adverbs={"x": 0.1, "q": 0.2}), 422, "unknown_adverb")
    assert reply["known"] == ["x", "y"]
    assert "'q'" in reply["detail"]


async def test_a_missing_adverb_is_named(client):
    reply = problem(await post(client, adverbs={"x": 0.1}), 422, "bad_request")
    assert "missing adverb y" in reply["detail"]


async def test_an_unknown_joint_names_the_known_ones(client, catalog):
    reply = problem(await post(client, adverbs=ARM, joints=["Knee"]), 422, "unknown_joint")
    assert reply["known"] == list(catalog.entry("arm3").verb.skeleton.names)


async def test_more_joints_than_there_are_is_refused(client):
    reply = problem(await post(client, adverbs=ARM, joints=["Tip"] * 9), 422, "out_of_range")
    assert "1 to 4 joints" in reply["detail"]


async def test_an_unknown_method_names_those_of_the_verb(client):
    reply = problem(await post(client, verb="sway", adverbs=SWAY, method="magic"), 422, "unknown_method")
    assert "rbf" in reply["known"]


@pytest.mark.parametrize("literal", ["NaN", "Infinity", "-Infinity", "1e999", "null", '"0.3"', "true", "[0.3]"])
async def test_an_adverb_that_is_no_finite_number_is_refused(client, literal):
    text = f'{{"adverbs": {{"x": {literal}, "y": 0.1}}}}'
    reply = problem(await client.post("/v1/verbs/arm3/pose", content=text, headers=JSON), 422, "invalid_request")
    assert reply["errors"][0]["at"] == "adverbs.x"


async def test_a_huge_adverb_is_out_of_range(client):
    assert "adverb 'x'" in problem(await post(client, adverbs={"x": 1e300, "y": 0}), 422, "out_of_range")["detail"]


@pytest.mark.parametrize("phase", [1.0001, 7.0])
async def test_a_phase_past_the_end_says_its_bounds(client, phase):
    reply = problem(await post(client, adverbs=ARM, phase=phase), 422, "out_of_range")
    assert "between 0 and 1" in reply["detail"]


async def test_a_phase_below_zero_is_refused(client):
    reply = problem(await post(client, adverbs=ARM, phase=-0.1), 422, "invalid_request")
    assert reply["errors"] == [{"at": "phase", "problem": "Input should be greater than or equal to 0"}]


async def test_phase_and_time_together_are_refused(client):
    reply = problem(await post(client, adverbs=ARM, phase=0.1, time=0.1), 422, "bad_request")
    assert "not both" in reply["detail"]


async def test_an_unknown_field_names_the_known_ones(client):
    reply = problem(await post(client, adverbs=ARM, fase=0.1), 422, "invalid_request")
    assert "fase" in reply["detail"]
    assert "phase" in reply["detail"]


async def test_what_was_sent_is_not_repeated(client):
    answer = await post(client, adverbs=ARM, method=["secret" * 50])
    assert "secret" not in answer.text


async def test_many_mistakes_are_listed_up_to_a_bound(client):
    reply = problem(await post(client, route="poses", items=[{"a": 1}] * 100), 422, "invalid_request")
    assert len(reply["errors"]) == 16


async def test_very_many_mistakes_are_counted_only(client):
    """Listing 90,000 of them would block all other requests for a third of a second."""
    fields = dict.fromkeys((f"k{number}" for number in range(90_000)), 1)
    reply = problem(await post(client, route="sequence", adverbs=ARM, **fields), 422, "invalid_request")
    assert reply["detail"] == "body: 90000 mistakes; some are listed where there are at most 200"
    assert [row["at"] for row in reply["errors"]] == ["body"]


@pytest.mark.parametrize("text", ["", "{", "nope", '{"adverbs": {"x": 1,}}', "\ufeff{}", "[" * 5_000])
async def test_malformed_and_deep_json_is_refused(client, text):
    problem(await client.post("/v1/verbs/arm3/pose", content=text.encode(), headers=JSON), 400, "malformed_body")


async def test_bytes_that_are_no_text_are_refused(client):
    content = b'{"adverbs": {"\xff": 1}}'
    problem(await client.post("/v1/verbs/arm3/pose", content=content, headers=JSON), 400, "malformed_body")


@pytest.mark.parametrize("value", ["[]", "3", '"text"', "null"])
async def test_json_that_is_no_object_is_refused(client, value):
    problem(await client.post("/v1/verbs/arm3/pose", content=value, headers=JSON), 422, "invalid_request")


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "application/octet-stream", ""])
async def test_another_content_type_is_refused_with_the_right_one(client, kind):
    answer = await client.post("/v1/verbs/arm3/pose", content=b"{}", headers={"Content-Type": kind} if kind else {})
    assert problem(answer, 415, "unsupported_media_type")["known"] == ["application/json"]


async def test_content_types_may_have_parameters_and_capitals(client):
    headers = {"Content-Type": "Application/JSON; charset=utf-8"}
    answer = await client.post("/v1/verbs/arm3/pose", content=b'{"adverbs":{"x":0.4,"y":0.3}}', headers=headers)
    assert answer.status_code == 200


async def test_forms_that_a_route_cannot_give_are_refused(client):
    answer = await client.post("/v1/verbs/arm3/pose", json={"adverbs": ARM}, headers={"Accept": "image/png, text/*"})
    assert problem(answer, 406, "not_acceptable")["known"] == ["application/json", "application/octet-stream"]


@pytest.mark.parametrize(
    ("accept", "form"),
    [
        ("*/*", "application/json"),
        ("application/*", "application/json"),
        ("application/octet-stream;q=0.9, application/json;q=0.5", "application/octet-stream"),
        ("application/json;q=0, */*", "application/octet-stream"),
        ("text/html, application/octet-stream", "application/octet-stream"),
        ("application/json;q=x, application/octet-stream;q=0.1", "application/octet-stream"),
    ],
)
async def test_the_client_s_preferences_decide_the_form(client, accept, form):
    answer = await client.post("/v1/verbs/arm3/pose", json={"adverbs": ARM}, headers={"Accept": accept})
    assert answer.headers["content-type"] == form


async def test_an_unknown_address_is_a_problem_too(client):
    for path in ("/nope", "/v1/verbs/", "/v1/verbs/arm3/pose/"):
        problem(await client.get(path), 404, "not_found")


async def test_a_wrong_method_names_the_right_one(client):
    answer = await client.get("/v1/verbs/arm3/pose")
    problem(answer, 405, "method_not_allowed")
    assert answer.headers["allow"] == "POST"
    assert "POST" in answer.json()["detail"]


async def test_a_long_body_is_refused_before_it_is_read(catalog):
    async with client_of(app_of(catalog, max_body_bytes=1_024)) as client:
        answer = await client.post("/v1/verbs/arm3/pose", content=b" " * 2_000, headers=JSON)
        assert problem(answer, 413, "body_too_large")["limit"] == 1_024


async def test_a_body_of_one_object_is_short(client):
    """It is parsed in the event loop, where it would delay every other request."""
    fields = ",".join(f'"a{k}":0' for k in range(10_000))
    answer = await client.post("/v1/verbs/arm3/pose", content="{" + fields + "}", headers=JSON)
    assert problem(answer, 413, "body_too_large")["limit"] == 65_536


@pytest.mark.parametrize("declared", ["-1", "many", "9" * 30])
async def test_a_length_that_is_no_length_is_refused(client, declared):
    headers = {**JSON, "Content-Length": declared}
    problem(await client.post("/v1/verbs/arm3/pose", content=b"{}", headers=headers), 413, "body_too_large")


async def test_a_long_streamed_body_is_refused_as_it_comes(catalog):
    sent = []

    async def stream():
        for k in range(1_000):
            sent.append(k)
            yield b" " * 100

    async with client_of(app_of(catalog, max_body_bytes=1_024)) as client:
        answer = await client.post("/v1/verbs/arm3/pose", content=stream(), headers=JSON)
        problem(answer, 413, "body_too_large")
    assert len(sent) < 20


async def test_too_many_items_are_refused_with_the_limit(catalog):
    async with client_of(app_of(catalog, max_batch=5, max_batch_json=3)) as client:
        answer = await post(client, route="poses", items=[{"adverbs": ARM}] * 4)
        assert problem(answer, 413, "batch_too_large")["limit"] == 3
        long = b'{"items": [' + b'{"adverbs": {}}, ' * 4 + b"not parsed"
        answer = await client.post("/v1/verbs/arm3/poses", content=long, headers=JSON)
        assert problem(answer, 413, "batch_too_large")["limit"] == 3
        headers = {"Content-Type": "application/octet-stream"}
        answer = await client.post("/v1/verbs/arm3/poses", content=bytes(12 * 6), headers=headers)
        assert problem(answer, 413, "batch_too_large")["limit"] == 5


@pytest.mark.parametrize("size", [0, 1, 11, 13])
async def test_binary_rows_must_be_whole(client, size):
    headers = {"Content-Type": "application/octet-stream"}
    answer = await client.post("/v1/verbs/arm3/poses", content=bytes(size), headers=headers)
    assert "12 bytes each: x, y, phase" in problem(answer, 400, "malformed_body")["detail"]


@pytest.mark.parametrize("row", [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, np.nan], [0, 0, -1], [0, 0, 2]])
async def test_binary_rows_are_checked_like_json(client, row):
    headers = {"Content-Type": "application/octet-stream"}
    answer = await client.post("/v1/verbs/arm3/poses", content=np.array(row, "<f4").tobytes(), headers=headers)
    problem(answer, 422, "out_of_range")


async def test_options_in_the_query_of_a_json_body_are_refused(client):
    answer = await client.post("/v1/verbs/arm3/poses?method=rbf", json={"items": [{"adverbs": ARM}]})
    assert "'method' is in the query" in problem(answer, 422, "bad_request")["detail"]
    answer = await client.post("/v1/verbs/arm3/poses?space=outer", json={"items": [{"adverbs": ARM}]})
    assert problem(answer, 422, "invalid_request")["errors"][0]["at"] == "query.space"


@pytest.mark.parametrize(
    "items",
    [
        [{"adverbs": ARM, "phase": 0.1}, {"adverbs": ARM, "time": 0.1}],
        [{"adverbs": ARM, "phase": 0.1, "time": 0.1}],
        [{"adverbs": ARM}, {"adverbs": ARM, "time": 0.1}],
    ],
)
async def test_items_that_mix_phase_and_time_are_refused(client, items):
    assert (
        "all must have the same"
        in problem(await post(client, route="poses", items=items), 422, "bad_request")["detail"]
    )


async def test_an_empty_batch_is_refused(client):
    problem(await post(client, route="poses", items=[]), 422, "invalid_request")


@pytest.mark.parametrize("body", [{}, {"adverbs": ARM, "track": [{"time": 0, "adverbs": ARM}]}])
async def test_a_sequence_needs_adverbs_or_a_track(client, body):
    assert "either 'adverbs' or 'track'" in (await post(client, route="sequence", **body)).json()["detail"]


async def test_cycles_of_a_verb_that_does_not_loop_are_refused(client):
    problem(await post(client, route="sequence", adverbs=ARM, cycles=2), 422, "bad_request")


@pytest.mark.parametrize("option", [{"fps": 0.5}, {"fps": 241}, {"cycles": 0}, {"cycles": 101}, {"cycles": 1.5}])
async def test_rates_and_cycles_are_bounded(client, option):
    problem(await post(client, verb="sway", route="sequence", adverbs=SWAY, **option), 422, "invalid_request")


async def test_a_track_s_times_must_rise(client):
    track = [{"time": 1, "adverbs": ARM}, {"time": 1, "adverbs": ARM}]
    assert "rise" in problem(await post(client, route="sequence", track=track), 422, "out_of_range")["detail"]


async def test_a_failure_inside_is_a_problem_without_its_reason(catalog, monkeypatch):
    def explode(self):
        raise ZeroDivisionError("secret of the house")

    monkeypatch.setattr(state.ServerState, "current", explode)
    async with client_of(app_of(catalog)) as client:
        answer = await client.get("/v1/verbs", headers={"X-Request-Id": "mine-1"})
        problem(answer, 500, "internal_error")
        assert "secret" not in answer.text
        assert answer.headers["x-request-id"] == "mine-1"


async def test_a_client_that_leaves_is_no_failure(app):
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "POST", "scheme": "http",
        "path": "/v1/verbs/arm3/pose", "raw_path": b"/v1/verbs/arm3/pose", "query_string": b"", "root_path": "",
        "headers": [(b"content-type", b"application/json")], "client": None, "server": None,
    }  # fmt: skip
    sent = asyncio.Queue()

    async def receive():
        return {"type": "http.disconnect"}

    await app(scope, receive, sent.put)
    assert sent.empty()
    assert b'status="499"' in app.state.server.metrics.text()
    assert issubclass(ClientDisconnect, Exception)


@pytest.mark.parametrize("given", ["a b", "x" * 65, "é", ""])
async def test_a_harmful_request_id_is_replaced(client, given):
    answer = await client.get("/livez", headers={"X-Request-Id": given.encode()})
    assert answer.headers["x-request-id"] != given
    assert len(answer.headers["x-request-id"]) == 16


def kinds(root: type) -> list[type]:
    return [root, *(kind for child in root.__subclasses__() for kind in kinds(child))]


def test_every_error_of_the_library_has_a_problem_of_the_client_or_none():
    for kind in kinds(VerbError):
        err = UnknownName("thing", "a", ("b",)) if kind is UnknownName else kind.__new__(kind)
        assert 400 <= errors.response_of(err).status_code < 500
    assert errors.response_of(RequestError("no")).status_code == 422


def test_every_error_of_the_service_has_a_row_in_the_table():
    for kind in kinds(errors.ServiceError)[1:]:
        assert errors.response_of(kind("because")).status_code >= 400
