"""The dashboard of a server that needs keys, in a real browser."""

import re
from dataclasses import dataclass

import httpx
import pytest

from service.store.keys import Keys, open_keys
from tests.dashboard.conftest import PATIENCE_S, Service, opened
from tests.service.access.conftest import added, bearer

pytestmark = [pytest.mark.xdist_group("dashboard"), pytest.mark.slow]

PAGE_OF_CHANGES = 20
REFUSED = ("401", "403", "WebSocket connection")
"""What a browser logs about refused requests."""

STREAMS = "adverb.connection === 'open' && adverb.stats?.messagesPerS > 0"


@dataclass
class Guarded:
    """A server whose store has keys."""

    service: Service
    store: Keys

    def key(self, *scopes, name="a key"):
        return added(self.store, *scopes, name=name)

    def revoke(self, key):
        assert self.store.revoke(key.split("_")[1])

    def client(self, key):
        return httpx.Client(base_url=self.service.url, headers=bearer(key), timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def guarded(built, tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    store = open_keys(f"sqlite:///{folder / 'state.db'}")
    added(store, "pose", name="the first")
    settings = {"ADVERB_REFINERS": "0", "ADVERB_LOG_LEVEL": "debug", "ADVERB_STREAMS_PER_KEY": "1"}
    service = Service(folder, folder / "log.txt", **settings).start()
    yield Guarded(service, store)
    service.stop()
    store.close()


@pytest.fixture
def page(browser, guarded):
    with opened(browser, guarded.service) as found:
        found.sent = []
        found.tab.on("request", lambda request: found.sent.append(request.url))
        found.tab.on("websocket", lambda socket: found.sent.append(socket.url))
        yield found
        found.ignore(*REFUSED)


def visit(page, **view):
    """Open the page up to its prompt."""
    query = "&".join(f"{name}={value}" for name, value in {"detail": "low", "verb": "reach", **view}.items())
    page.tab.goto(f"{page.service.url}/#{query}")
    prompt(page).wait_for()


def prompt(page):
    return page.tab.get_by_role("dialog", name="This server needs a key")


def enter(page, key):
    page.tab.get_by_label("Key", exact=True).fill(key)
    page.tab.get_by_role("button", name="Continue").click()


def enter_accepted(page, key):
    enter(page, key)
    prompt(page).wait_for(state="hidden")


def select(page, tab):
    page.tab.get_by_role("tab", name=tab).click()


def test_a_key_opens_the_page_and_is_nowhere_but_in_the_tab(page, guarded):
    key, wrong = guarded.key("pose"), "adv_0123456789abcdef_" + "x" * 43
    visit(page)
    enter(page, wrong)
    page.tab.get_by_role("alert").filter(has_text="unknown").wait_for()
    assert prompt(page).is_visible()
    page.tab.keyboard.press("Escape")
    page.tab.keyboard.press("Escape")
    prompt(page).wait_for()
    enter_accepted(page, key)
    page.until("document.documentElement.dataset.ready === 'true'")
    page.until(STREAMS)
    stored = page.tab.evaluate("[JSON.stringify(localStorage), document.cookie, location.href]")
    assert page.tab.evaluate("Object.values(sessionStorage)") == [key]
    log = guarded.service.log.read_text()
    assert "server started" in log
    for text in (key, key.split("_", 2)[2], wrong.split("_", 2)[2]):
        assert not any(text in each for each in (*stored, *page.sent))
        assert text not in log
    assert any(url.endswith("/v1/stream") for url in page.sent)


def test_the_key_lasts_as_long_as_the_tab(page, guarded):
    visit(page)
    enter_accepted(page, guarded.key("pose"))
    page.tab.reload()
    page.until("document.documentElement.dataset.ready === 'true'")
    assert not prompt(page).is_visible()
    page.until(STREAMS)
    other = page.tab.context.new_page()
    other.goto(f"{page.service.url}/#detail=low")
    other.get_by_role("dialog", name="This server needs a key").wait_for()


def test_after_a_revocation_the_stream_continues_with_another_key(page, guarded):
    first, second = guarded.key("pose"), guarded.key("pose")
    visit(page)
    enter_accepted(page, first)
    page.until(STREAMS)
    before = page.state("adverb.view")
    guarded.revoke(first)
    prompt(page).get_by_text("The key is not valid any more").wait_for()
    sockets = len([url for url in page.sent if url.endswith("/v1/stream")])
    page.tab.wait_for_timeout(1500)  # several of the shortest pauses
    assert len([url for url in page.sent if url.endswith("/v1/stream")]) == sockets
    enter_accepted(page, second)
    page.until(STREAMS)
    frames = page.state("adverb.drawn.frames")
    page.until(f"adverb.drawn.frames > {frames}")
    assert page.state("adverb.view") == before


def test_what_was_entered_is_sent_after_another_key(page, guarded):
    first, second = guarded.key("pose", "refine"), guarded.key("pose", "refine")
    visit(page, panel="quality")
    enter_accepted(page, first)
    page.until(STREAMS)
    page.tab.get_by_label("Max. pseudo-examples").fill("7")
    page.tab.get_by_label("Time limit, s").fill("43")
    guarded.revoke(first)
    prompt(page).wait_for()
    page.tab.evaluate("document.querySelector('form.refine').requestSubmit()")  # the dialog covers the button
    enter_accepted(page, second)
    page.tab.get_by_text("7 pseudo-examples at most, 43 s").wait_for()
    page.tab.locator(".refinement-row").get_by_role("button", name="Cancel").click()
    page.tab.locator(".refinement-row[data-state=cancelled]").wait_for()


def test_a_key_for_poses_looks_and_streams_but_changes_nothing(page, guarded):
    visit(page)
    enter_accepted(page, guarded.key("pose", name="looker"))
    page.until(STREAMS)
    assert page.tab.get_by_role("button", name="Add a clip…").is_disabled()
    select(page, "Quality")
    page.tab.get_by_text("This needs a key with the scope “refine”.").wait_for()
    assert page.tab.get_by_role("button", name="Start", exact=True).is_disabled()
    select(page, "Upload")
    page.tab.get_by_text("This needs a key with the scope “author”.").wait_for()
    assert page.tab.get_by_role("button", name="Choose a folder").is_disabled()
    assert page.tab.locator(".drop input").is_disabled()
    select(page, "Versions")
    with page.tab.expect_download() as downloaded:
        page.tab.get_by_role("button", name="Download").first.click()
    assert downloaded.value.path().stat().st_size > 1000
    assert not page.tab.get_by_text("Changes", exact=True).is_visible()
    assert not any("403" in text for text in page.problems)


def test_without_the_scope_for_streams_the_page_states_it(page, guarded):
    visit(page)
    enter_accepted(page, guarded.key("author"))
    page.tab.get_by_text("This needs a key with the scope “pose”.").wait_for()
    page.ignore("403")  # motions of the verb, which the page requests for its view


def test_the_service_tab_has_the_key_and_removes_it(page, guarded):
    visit(page, panel="service")
    enter_accepted(page, guarded.key("pose", "refine", name="of the studio"))
    page.tab.get_by_text(re.compile("of the studio · pose, refine · does not expire")).wait_for()
    page.until(STREAMS)
    page.tab.get_by_role("button", name="Forget the key").click()
    prompt(page).wait_for()
    assert page.tab.evaluate("Object.values(sessionStorage)") == []
    page.until("adverb.connection === 'lost'")


def test_too_many_streams_of_a_key(page, guarded, browser):
    key = guarded.key("pose")
    visit(page)
    enter_accepted(page, key)
    page.until(STREAMS)
    with opened(browser, guarded.service) as second:
        visit(second)
        enter_accepted(second, key)
        second.tab.locator(".overlay").get_by_text("stream").first.wait_for()
        page.tab.goto("about:blank")
        second.until(STREAMS)
        second.ignore(*REFUSED)


def test_changes_are_listed_by_pages_and_verbs(page, guarded):
    key = guarded.key("admin", name="chief")
    with guarded.client(key) as client:
        for _ in range(PAGE_OF_CHANGES // 2 + 1):
            job = client.post("/v1/verbs/board/refinements", json={"budget_s": 5}).raise_for_status().json()["id"]
            client.delete(f"/v1/refinements/{job}").raise_for_status()
        client.delete("/v1/verbs/arm3").raise_for_status()
    visit(page, panel="versions")
    enter_accepted(page, key)
    page.tab.get_by_text("Changes", exact=True).click()
    rows = page.tab.get_by_role("list", name="Changes").get_by_role("listitem")
    rows.first.get_by_text("Deleted arm3").wait_for()
    assert "(chief)" in rows.first.inner_text()
    assert rows.count() == PAGE_OF_CHANGES
    page.tab.get_by_role("button", name="Older changes").click()
    page.until(f"document.querySelectorAll('.changes li').length > {PAGE_OF_CHANGES}")
    page.tab.locator(".changes select").select_option("arm3")
    page.until(f"document.querySelectorAll('.changes li').length < {PAGE_OF_CHANGES}")
    assert all("arm3" in text for text in rows.all_inner_texts())
