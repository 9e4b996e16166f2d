"""The committed OpenAPI document is the code's, and the code keeps it."""

import json

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from schemathesis.config import SchemathesisConfig

from service.errors import PROBLEMS
from tests.service.conftest import app_of
from tools import openapi

_CONFIG = SchemathesisConfig.from_dict(
    {
        # Which adverbs a verb has is known by its name only, so what fits the schema may still be refused.
        "checks": {
            "positive_data_acceptance": {"expected-statuses": ["2xx", "400", "404", "406", "409", "413", "422"]},
            "negative_data_rejection": {"expected-statuses": ["4xx", "5xx"]},  # 413: a list beyond its bound is long
        },
    }
)


UNREAD = {  # no JSON to get wrong
    ("/v1/verbs", "post"),
    ("/v1/verbs/{verb}/versions/{number}/activate", "post"),
    ("/v1/drafts", "post"),
    ("/v1/verbs/{verb}/examples", "post"),
}
VALID, INVALID = schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE
OPERATIONS = [
    (path, method.upper(), mode)
    for path, operations in json.loads(openapi.FILE.read_text(encoding="utf-8"))["paths"].items()
    for method in operations
    for mode in ((VALID, INVALID) if (path, method) not in UNREAD and method == "post" else (VALID,))
]
STORING = {("/v1/verbs", "POST"), ("/v1/verbs/{verb}", "DELETE")}
ADVERBS = {"arm3": ("x", "y"), "sway": ("width", "haste")}


@pytest.fixture(scope="module")
def api(catalog):
    """The API of an app whose lifespan does nothing: schemathesis enters it anew for every call."""
    app = app_of(catalog, allowed_hosts="testserver")

    async def started(scope, receive, send):
        if scope["type"] != "lifespan":
            await app(scope, receive, send)
            return
        for event in ("startup", "shutdown"):
            await receive()
            await send({"type": f"lifespan.{event}.complete"})

    return schemathesis.openapi.from_asgi("/openapi.json", started, config=_CONFIG)


def known_names(value, adverbs):
    """A body in which the names that the document cannot know are those of a verb."""
    if isinstance(value, list):
        return [known_names(each, adverbs) for each in value]
    if not isinstance(value, dict):
        return value
    body = {key: known_names(each, adverbs) for key, each in value.items() if key not in ("joints", "version")}
    if isinstance(body.get("adverbs"), dict):
        numbers = [*body["adverbs"].values(), 0.1]
        body["adverbs"] = {name: numbers[k % len(numbers)] for k, name in enumerate(adverbs)}
    if body.get("method") is not None:
        body["method"] = "rbf"
    return body


@pytest.mark.parametrize(("path", "method", "mode"), OPERATIONS)
def test_every_answer_fits_the_document(api, path, method, mode):
    statuses = set()

    @given(case=api[path][method].as_strategy(generation_mode=mode), verb=st.sampled_from(["arm3", "sway", "nope"]))
    @settings(max_examples=12, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    def check(case, verb):
        if "verb" in case.path_parameters:  # made-up names would all be 404
            case.path_parameters["verb"] = verb
            if mode is VALID and verb in ADVERBS:
                case.body = known_names(case.body, ADVERBS[verb])
                if path.endswith("/sequence") and isinstance(case.body, dict):  # one of both, and arm3 does not loop
                    case.body |= {"adverbs": dict.fromkeys(ADVERBS[verb], 0.3), "track": None, "cycles": 1}
        statuses.add(case.call_and_validate().status_code)

    check()
    assert mode is INVALID or 200 in statuses or _changes(path, method)


def _changes(path, method):
    """Whether a route needs a store; this app has none and answers with a problem."""
    return (
        any(word in path for word in ("/versions", "/refinements", "/drafts", "/examples", "/audit"))
        or (path, method) in STORING
    )


def test_the_committed_document_is_the_code_s():
    assert openapi.FILE.read_text(encoding="utf-8") == openapi.text(), "run `make generate`"


def test_the_environment_does_not_change_the_document(monkeypatch):
    monkeypatch.setenv("ADVERB_MAX_BATCH", "7")
    monkeypatch.setenv("ADVERB_PORT", "7")
    assert openapi.FILE.read_text(encoding="utf-8") == openapi.text()


def test_every_documented_answer_of_an_error_is_a_problem():
    document = json.loads(openapi.text())
    assert document["openapi"].startswith("3.1")
    known = {str(row.status) for row in PROBLEMS.values()}
    for path, operations in document["paths"].items():
        for operation in operations.values():
            for status, response in operation["responses"].items():
                if status not in ("200", "201", "202", "204", "304"):
                    assert list(response["content"]) == ["application/problem+json"], (path, status)
                    assert status in known


def test_every_reference_in_the_document_resolves():
    text = openapi.text()
    schemas = json.loads(text)["components"]["schemas"]
    assert all(part.split('"')[0] in schemas for part in text.split("#/components/schemas/")[1:])


def test_the_guide_lists_every_route_and_every_problem():
    guide = (openapi.FILE.parent / "rest.md").read_text(encoding="utf-8")
    missing = [path for path in json.loads(openapi.text())["paths"] if f"{path}`" not in guide]
    missing += [row.code for row in PROBLEMS.values() if f"`{row.code}`" not in guide]
    assert not missing
