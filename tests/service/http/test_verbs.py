"""Routes that read: verbs, health and pages."""

import re
from dataclasses import replace
from types import MappingProxyType

import pytest

from service.catalog.catalog import Catalog
from service.http.routes import pages
from tests.service.conftest import app_of, client_of
from verbs import library
from verbs.runtime import describe

pytestmark = pytest.mark.anyio


@pytest.fixture(autouse=True)
def _no_dashboard(tmp_path, monkeypatch) -> None:
    """Whether it is built here or not."""
    monkeypatch.setattr(pages, "STATIC", tmp_path)


async def test_the_list_names_all_verbs_with_version_and_adverbs(client):
    rows = (await client.get("/v1/verbs")).json()["verbs"]
    assert [row["name"] for row in rows] == sorted([*library.names(), "sway"])
    sway = next(row for row in rows if row["name"] == "sway")
    assert sway["version"] == 1
    assert sway["adverbs"] == ["width", "haste"]
    assert sway["looping"]


async def test_a_description_is_what_the_library_describes(client, catalog):
    for name in catalog.entries:
        reply = (await client.get(f"/v1/verbs/{name}")).json()
        assert reply == describe.describe(catalog.entry(name).verb)


async def test_a_description_has_the_promised_fields(client):
    reply = (await client.get("/v1/verbs/arm3")).json()
    adverb = reply["adverbs"][0]
    assert {"name", "unit", "min", "max", "style"} <= adverb.keys()
    assert {"names", "parents", "offsets"} <= reply["skeleton"].keys()
    assert {"name", "adverbs", "keytimes", "point"} == reply["examples"][0].keys()
    assert set(reply["examples"][0]["adverbs"]) == {"x", "y"}
    assert {"keytime_names", "looping", "domain", "methods", "quality", "version"} <= reply.keys()
    assert reply["default_method"] in reply["methods"]


async def test_a_verb_lists_only_methods_that_it_can_be_asked_with(client):
    for name, adverbs in {"sway": {"width": 0.2, "haste": 0.3}, "arm3": {"x": 0.4, "y": 0.3}}.items():
        for method in (await client.get(f"/v1/verbs/{name}")).json()["methods"]:
            answer = await client.post(f"/v1/verbs/{name}/pose", json={"adverbs": adverbs, "method": method})
            assert answer.status_code == 200, answer.text
            assert answer.json()["method"] == method


async def test_an_unchanged_description_is_not_sent_again(client):
    first = await client.get("/v1/verbs/arm3")
    again = await client.get("/v1/verbs/arm3", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    other = await client.get("/v1/verbs/arm3", headers={"If-None-Match": '"other"'})
    assert other.status_code == 200


async def test_the_served_artifact_is_the_file(client, catalog):
    answer = await client.get("/v1/verbs/arm3/artifact")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.content == catalog.entry("arm3").path.read_bytes()
    known = {"If-None-Match": f'"other", {answer.headers["etag"]}'}
    again = await client.get("/v1/verbs/arm3/artifact", headers=known)
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", answer.headers["etag"])
    assert (await client.get("/v1/verbs/arm3/artifact", headers={"If-None-Match": '"other"'})).status_code == 200
    assert (await client.get("/v1/verbs/none/artifact")).json()["code"] == "unknown_verb"
    version = catalog.entry("arm3").version
    assert (await client.get(f"/v1/verbs/arm3/artifact?version={version}")).content == answer.content
    other = await client.get(f"/v1/verbs/arm3/artifact?version={version + 1}")
    assert (other.status_code, other.json()["code"]) == (409, "read_only")


async def test_a_served_artifact_that_is_gone_is_an_error(catalog, tmp_path):
    entry = replace(catalog.entry("arm3"), path=tmp_path / "gone.verb")
    async with client_of(app_of(Catalog(MappingProxyType({"arm3": entry}), ()))) as client:
        answer = await client.get("/v1/verbs/arm3/artifact")
    assert (answer.status_code, answer.json()["code"]) == (500, "artifact_damaged")
    assert "No such file" in answer.json()["detail"]


async def test_health_under_both_names(client):
    for path in ("/livez", "/v2/health/live"):
        answer = await client.get(path)
        assert (answer.status_code, answer.json()) == (200, {"live": True})
    plain, kserve = (await client.get("/readyz")), (await client.get("/v2/health/ready"))
    assert plain.json() == kserve.json()
    assert plain.json()["ready"]


async def test_nothing_is_ready_before_verbs_are_loaded():
    async with client_of(app_of(None)) as client:
        assert (await client.get("/livez")).status_code == 200
        for path in ("/readyz", "/v2/health/ready", "/v1/verbs", "/v1/verbs/arm3"):
            answer = await client.get(path)
            assert answer.status_code == 503
            assert answer.json()["code"] == "not_ready"
            assert answer.headers["retry-after"] == "1"
        assert "being loaded" in (await client.get("/")).text


async def test_the_lifespan_makes_it_ready(data_dir):
    reply = []
    app = app_of(None, data=data_dir)
    app.state.server._on_ready = reply.append
    async with app.router.lifespan_context(app), client_of(app) as client:
        await app.state.server.ready.wait()
        assert (await client.get("/readyz")).status_code == 200
    assert [set(catalog.entries) for catalog in reply] == [{*library.names(), "sway"}]


async def test_pages_make_no_outside_request(client):
    for path in ("/", "/docs"):
        page = await client.get(path)
        assert page.status_code == 200
        assert page.headers["content-security-policy"].startswith("default-src 'none'")
        outside = re.findall(r"""(?:src|href|url)\s*[=(]\s*['"]?(?:https?:)?//[^'">\s]*""", page.text)
        assert not outside
        assert "<script" not in page.text


async def test_the_welcome_page_says_what_is_served_and_what_is_broken(client):
    page = (await client.get("/")).text
    for text in ("/v1/verbs/sway", "/docs", "/metrics", "cut.verb"):
        assert text in page


async def test_the_reference_has_every_route_schema_and_problem(client):
    page, document = (await client.get("/docs")).text, (await client.get("/openapi.json")).json()
    for path, operations in document["paths"].items():
        assert path in page
        assert all(f"id='{operation['operationId']}'" in page for operation in operations.values())
    assert all(f"id='{name}'" in page for name in document["components"]["schemas"])
    assert "curl -X POST http://127.0.0.1:8000/v1/verbs/reach/pose" in page
    assert "id='unknown_verb'" in page
