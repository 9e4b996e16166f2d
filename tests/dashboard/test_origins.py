"""Pages of another origin, in a real browser against a real server on this machine."""

import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest

from tests.dashboard.conftest import Service

pytestmark = [pytest.mark.xdist_group("dashboard"), pytest.mark.slow]

ATTEMPTS = """async url => {
  const tried = async attempt => { try { return await attempt() } catch (error) { return "refused" } };
  const json = {"Content-Type": "application/json"};
  const adverbs = JSON.stringify({adverbs: {x: 0.4, y: 0.2}});
  const loaded = (tag, path) => new Promise(done => {
    const element = document.createElement(tag);
    element.onload = () => done("loaded");
    element.onerror = () => done("refused");
    element.src = url + path;
    document.body.append(element);
  });
  return {
    read: await tried(async () => (await (await fetch(url + "/v1/verbs")).json()).verbs.length > 0),
    pose: await tried(async () =>
      (await fetch(url + "/v1/verbs/arm3/pose", {method: "POST", headers: json, body: adverbs})).status),
    form: await tried(async () =>
      (await fetch(url + "/v1/verbs/arm3/versions/1/activate", {method: "POST", mode: "no-cors"})).type),
    erase: await tried(async () => (await fetch(url + "/v1/verbs/arm3", {method: "DELETE"})).status),
    stream: await new Promise(done => {
      const socket = new WebSocket(url.replace("http", "ws") + "/v1/stream", ["adverb.v1"]);
      socket.onmessage = () => { socket.close(); done("opened") };
      socket.onerror = () => done("refused");
    }),
    script: await loaded("script", "/v1/verbs"),
    image: await loaded("img", "/v1/verbs"),
  };
}"""
"""What a page may try on a server: read, ask, change and stream by script; load answers as a script and an image."""


class Quiet(SimpleHTTPRequestHandler):
    """A file server without a log."""

    def log_message(self, *_):
        """Print nothing."""


@pytest.fixture
def stranger(tmp_path):
    """Origin of a page that is not the server's."""
    (tmp_path / "index.html").write_text("<!doctype html><title>stranger</title><body></body>")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=tmp_path))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def visit(browser, stranger):
    """Let the stranger's page try everything on a server."""

    def attempts(url):
        context = browser.new_context()
        tab = context.new_page()
        tab.goto(f"{stranger}/index.html")
        found = tab.evaluate(ATTEMPTS, url)
        context.close()
        return found

    return attempts


@pytest.fixture
def serve(tmp_path):
    """Start servers with environment variables."""
    started = []
    (tmp_path / "data").mkdir()

    def start(**environment):
        started.append(Service(tmp_path / "data", ADVERB_REFINERS="0", **environment).start())
        return started[-1].url

    yield start
    for service in started:
        service.stop()


def verbs(url):
    return httpx.get(f"{url}/v1/verbs").json()


def test_a_strangers_page_can_neither_read_nor_change_anything(serve, visit):
    url = serve()
    before = verbs(url)
    assert set(visit(url).values()) == {"refused"}
    assert verbs(url) == before


def test_a_page_of_a_listed_origin_can(serve, visit, stranger):
    url = serve(ADVERB_CORS_ORIGINS=stranger)
    assert "arm3" in [verb["name"] for verb in verbs(url)["verbs"]]
    found = visit(url)
    assert (found["read"], found["pose"], found["stream"]) == (True, 200, "opened")
    assert found["erase"] == 204
    assert "arm3" not in [verb["name"] for verb in verbs(url)["verbs"]]
    assert (found["script"], found["image"]) == ("refused", "refused")
