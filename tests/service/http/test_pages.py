"""What a browser gets at `/`: the dashboard where it is built, else what is served."""

import re
from pathlib import Path

import pytest

from service.http.routes import pages
from tests.service.conftest import app_of, client_of

pytestmark = pytest.mark.anyio

SOURCES = Path(__file__).parents[3] / "clients" / "dashboard"


@pytest.fixture
def built(tmp_path, monkeypatch) -> Path:
    """A built page, of the shape that the bundler gives it."""
    folder = tmp_path / "static"
    (folder / "assets").mkdir(parents=True)
    (folder / "index.html").write_text("<!doctype html><script type='module' src='/assets/index-1a2b.js'></script>")
    (folder / "assets" / "index-1a2b.js").write_text("export {}")
    (folder / "assets" / "index-1a2b.css").write_text("body{}")
    (tmp_path / "secret.txt").write_text("not to be given")
    monkeypatch.setattr(pages, "STATIC", folder)
    return folder


async def test_the_dashboard_is_given_where_it_is_built(built, client):
    answer = await client.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    assert answer.content == (built / "index.html").read_bytes()
    assert answer.headers["cache-control"] == "no-cache"


async def test_the_browser_may_load_from_this_server_only(built, client):
    policy = (await client.get("/")).headers["content-security-policy"]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    for name in ("default-src", "script-src", "worker-src"):
        assert rules[name] == "'self'"
    assert rules["connect-src"] == "'self' blob:"  # textures of a figure that is dropped
    assert not re.search(r"https?:|\*|unsafe-eval", policy)
    assert "unsafe-inline" not in policy.replace(rules["style-src"], "")


async def test_files_are_kept_for_good_and_have_their_types(built, client):
    for name, kind in {"index-1a2b.js": "javascript", "index-1a2b.css": "text/css"}.items():
        answer = await client.get(f"/assets/{name}")
        assert answer.content == (built / "assets" / name).read_bytes()
        assert kind in answer.headers["content-type"]
        assert "immutable" in answer.headers["cache-control"]
        assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "path", ["../index.html", "..%2findex.html", "%2e%2e/%2e%2e/secret.txt", "/etc/passwd", "", "."]
)
async def test_nothing_else_is_given(built, client, path):
    answer = await client.get(f"/assets/{path}")
    assert answer.status_code == 404
    assert answer.json()["code"] == "not_found"
    assert "immutable" not in answer.headers.get("cache-control", "")


async def test_it_is_given_before_verbs_are_loaded(built):
    async with client_of(app_of(None)) as client:
        assert (await client.get("/")).status_code == 200


async def test_without_it_the_page_says_what_is_served_and_how_to_build_it(tmp_path, monkeypatch, client):
    monkeypatch.setattr(pages, "STATIC", tmp_path)
    page = (await client.get("/")).text
    assert "/v1/verbs/arm3" in page
    assert "make dashboard" in page
    assert (await client.get("/assets/index-1a2b.js")).status_code == 404


def test_its_lock_file_names_no_registry():
    lock = (SOURCES / "package-lock.json").read_text()
    assert '"resolved"' not in lock
    assert "omit-lockfile-registry-resolved=true" in (SOURCES / ".npmrc").read_text()
