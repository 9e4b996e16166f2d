"""The element `<adverb-figure>` in Chromium, with the built package and a server."""

from __future__ import annotations

import re
import time
from contextlib import contextmanager

import pytest

from tests.clients.typescript.node import PACKAGE
from tests.dashboard.conftest import CHROMIUM, FLAGS

DIST = PACKAGE / "dist"
PATIENCE_S = 60.0

PAGE = """<!doctype html><meta charset="utf-8"><body style="margin:0">
<script type="module" src="/dist/element/index.js"></script>
<adverb-figure id="held" verb="reach" x="-0.3" y="1.2" z="0.4" phase="0.5" style="color:#c2553d"></adverb-figure>
<adverb-figure id="moving" verb="arm3"></adverb-figure>
<adverb-figure id="wrong" verb="nothing"></adverb-figure>
</body>"""

COLOURED = """(() => {
  const canvas = document.querySelector('#held').shadowRoot.querySelector('canvas');
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let k = 0; k < data.length; k += 4) count += data[k] > 1.5 * data[k + 2] && data[k + 3] > 200;
  return count / (data.length / 4);
})()"""


@contextmanager
def opened(address, page=PAGE, lost=()):
    """The page in a tab, as if the server had it; the first request of each path in ``lost`` has no response."""
    from playwright.sync_api import sync_playwright

    lost = set(lost)

    def answer(route):
        path = route.request.url.removeprefix(address)
        if path in lost:
            lost.remove(path)
            route.abort()
        elif path == "/page":
            route.fulfill(body=page, content_type="text/html")
        elif path.startswith("/dist/"):
            route.fulfill(body=(DIST / path.removeprefix("/dist/")).read_text("utf-8"), content_type="text/javascript")
        else:
            route.continue_()

    with sync_playwright() as playwright:
        # a page that no server sent counts as one of another network
        flags = [*FLAGS, "--disable-features=LocalNetworkAccessChecks"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        tab = browser.new_page()
        tab.route("**/*", answer)
        tab.goto(f"{address}/page")
        yield tab
        browser.close()


def until(tab, expression, holds=bool):
    end = time.monotonic() + PATIENCE_S
    while not holds(found := tab.evaluate(expression)):
        assert time.monotonic() < end, (expression, found)
        tab.wait_for_timeout(50)
    return found


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_figures_are_drawn_follow_their_attributes_and_share_a_connection(address, server):
    before = len(server.hub.sessions)
    with opened(address) as tab:
        until(tab, "document.querySelectorAll('[drawn]').length === 2")
        assert until(tab, COLOURED) > 0.02
        wrong = "document.querySelector('#wrong').shadowRoot.querySelector('p').textContent"
        assert "unknown verb 'nothing'" in until(tab, wrong, lambda text: "unknown" in text)
        assert len(server.hub.sessions) == before + 1
        tab.evaluate("document.querySelector('#held').setAttribute('x', '-0.1')")
        hand = "document.querySelector('#held').stream.goal.x"
        until(tab, hand, lambda x: x == -0.1)
        phase = "document.querySelector('#moving').stream.pose().phase"
        first = until(tab, phase, lambda value: value is not None)
        until(tab, phase, lambda value: abs(value - first) > 0.05)
        tab.evaluate("document.querySelectorAll('adverb-figure').forEach((each) => each.remove())")
        until(tab, "1", lambda _: len(server.hub.sessions) == before)


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_an_element_whose_server_cannot_be_reached_tries_again(address, server):
    before = len(server.hub.sessions)
    page = PAGE.partition("<adverb-figure")[0] + '<adverb-figure verb="arm3"></adverb-figure>'
    with opened(address, page, lost=["/v1/verbs/arm3"]) as tab:
        text = "document.querySelector('adverb-figure').shadowRoot.querySelector('p').textContent"
        assert until(tab, text, lambda found: found not in ("", "Loading …")) == "no response from the server"
        until(tab, "document.querySelectorAll('[drawn]').length === 1")
        tab.evaluate("document.querySelector('adverb-figure').remove()")
        until(tab, "1", lambda _: len(server.hub.sessions) == before)


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_the_example_of_the_readme_is_drawn(address):
    block = re.findall(r"```html\n(.*?)```", (PACKAGE / "README.md").read_text("utf-8"), re.DOTALL)[0]
    page = block.replace("adverb-client/element", "/dist/element/index.js").replace("http://127.0.0.1:8000", address)
    assert page.count("/dist/") == page.count(address) == 1
    with opened(address, f"<!doctype html>{page}") as tab:
        until(tab, "document.querySelectorAll('[drawn]').length === 1")
