"""A real server process and the dashboard in a real browser."""

import json
import os
import shutil
import socket
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import pytest

from tests.warm import warm

PROJECT = Path(__file__).parents[2]
STATIC = PROJECT / "service" / "static" / "index.html"
CHROMIUM = next((path for name in ("chromium", "chromium-browser") if (path := shutil.which(name))), None)
PATIENCE_S = 240.0

FLAGS = [
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
]


class Service:
    """`adverb serve` on a fixed free port, so that it can be restarted; its log is kept if a file is given."""

    def __init__(self, data: Path, log: Path | None = None, **environment: str):
        self.data, self.log, self.environment = data, log, environment
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self.process = None

    def start(self):
        environment = {**os.environ, "ADVERB_REFINERS": "1", **self.environment}
        arguments = ("serve", "--port", str(self.port), "--data", str(self.data))
        with ExitStack() as files:
            log = files.enter_context(self.log.open("a")) if self.log else None
            self.process = warm().start(*arguments, environment=environment, stdout=log, stderr=log)
        deadline, last = time.monotonic() + PATIENCE_S, ""
        while time.monotonic() < deadline:
            try:
                response = httpx.get(f"{self.url}/readyz", timeout=5)
                if response.status_code == 200:
                    return self
                last = response.text
            except httpx.HTTPError as err:
                last = repr(err)
            assert self.process.poll() is None, "the server exited"
            time.sleep(0.1)
        raise AssertionError(f"the server never became ready: {last}")

    def kill(self):
        if self.process is not None:
            self.process.end()
            self.process = None

    def stop(self):
        if self.process is not None:
            self.process.terminate()
            self.process.wait(PATIENCE_S)
            self.process = None


@pytest.fixture(scope="session")
def built():
    """Index of the built dashboard; `make test` builds it if npm is installed."""
    if not STATIC.is_file():
        pytest.skip("the dashboard is not built; run `make dashboard`")
    return STATIC


@pytest.fixture(scope="module")
def service(built, tmp_path_factory):
    served = Service(tmp_path_factory.mktemp("dashboard")).start()
    yield served
    served.stop()


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield found
        found.close()


class Page:
    """The dashboard in one tab; console errors and external requests fail the test."""

    def __init__(self, tab, service):
        self.tab, self.service, self.problems = tab, service, []
        tab.on("console", lambda message: message.type == "error" and self.problems.append(message.text))
        tab.on("pageerror", lambda error: self.problems.append(str(error)))
        tab.on("request", lambda request: self._check_origin(request.url))

    def _check_origin(self, url):
        if not url.startswith((self.service.url, f"ws://127.0.0.1:{self.service.port}", "blob:", "data:")):
            self.problems.append(f"external request: {url}")

    def ignore(self, *texts):
        """Discard expected problems."""
        self.problems = [text for text in self.problems if not any(part in text for part in texts)]

    def open(self, **view):
        """Open the page at a view and wait for its first picture."""
        query = "&".join(f"{name}={value}" for name, value in {"detail": "low", **view}.items())
        self.tab.goto(f"{self.service.url}/#{query}")
        self.until("document.documentElement.dataset.ready === 'true'")
        return self

    def state(self, expression):
        """Value of an expression on `window.adverb`."""
        return json.loads(self.tab.evaluate(f"JSON.stringify((({expression}) ?? null))"))

    def until(self, condition, timeout_s=PATIENCE_S):
        """Poll a condition on `window.adverb`; the content security policy forbids evaluated waits."""
        end = time.monotonic() + timeout_s
        while not self.tab.evaluate(f"Boolean({condition})"):
            assert time.monotonic() < end, condition
            self.tab.wait_for_timeout(30)


@contextmanager
def opened(browser, service, **context):
    """A tab that must end without problems."""
    within = browser.new_context(viewport={"width": 1000, "height": 640}, **context)
    within.set_default_timeout(1000 * PATIENCE_S)
    page = Page(within.new_page(), service)
    try:
        yield page
    finally:
        within.close()
    assert page.problems == []


@pytest.fixture
def page(browser, service):
    with opened(browser, service) as found:
        yield found
