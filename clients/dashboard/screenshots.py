"""Screenshots of the dashboard, one per state, from a temporary server.

`screenshots.py [-o DIR] [--only REGEX] [FILE.verb …]`: run `make dashboard` first. Verbs given as files are served in
addition to the built-in ones. Requires Playwright and Chromium on the path.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

PROJECT = Path(__file__).parents[2]
START = "from service.cli import main; main()"
FLAGS = [
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
]
WIDE, SMALL, PHONE = (1280, 720), (1000, 640), (390, 844)
PATIENCE_S = 90.0
BUILT_IN = ("arm3", "board", "reach")
PANELS = ("quality", "versions", "service", "upload")
DRIVE = {"verb": "locomotion", "drive": "yes"}
REACH = {"at.x": "-0.35", "at.y": "1.45", "at.z": "0.45"}

Act = Callable[[Page], object]


@dataclass(frozen=True)
class State:
    """A screenshot: its name, view, preparation and window."""

    name: str
    view: dict[str, str]
    act: Act = lambda page: page.wait_for_timeout(600)
    size: tuple[int, int] = WIDE
    scheme: str = "light"
    loads: bool = True


class Service:
    """`adverb serve` on a free port with a temporary data folder."""

    def __init__(self, data: Path, verbs: list[Path]):
        for path in verbs:
            shutil.copy(path, data)
        self.log = data / "log.txt"
        self.process = subprocess.Popen(
            [sys.executable, "-c", START, "serve", "--port", "0", "--data", str(data)],
            cwd=PROJECT,
            env={**os.environ, "ADVERB_REFINERS": "1"},
            stderr=self.log.open("w"),
        )
        self.url = self._address()

    def stop(self) -> None:
        """Stop the server; idempotent."""
        self.process.terminate()
        self.process.wait()

    def _address(self) -> str:
        while self.process.poll() is None:
            if found := re.search(r"http://127\.0\.0\.1:\d+", self.log.read_text()):
                return found[0]
            time.sleep(0.1)
        raise SystemExit("the server exited before it listened")


def until(page: Page, condition: str) -> None:
    """Poll a condition; the content security policy forbids evaluated waits."""
    end = time.monotonic() + PATIENCE_S
    while not page.evaluate(f"Boolean({condition})"):
        if time.monotonic() > end:
            raise TimeoutError(condition)
        page.wait_for_timeout(50)


def pause_at_goal(page: Page) -> None:
    """Pause at the goal's keytime, or anywhere without one."""
    button = page.get_by_role("button", name="Pause at goal")
    button.click() if button.is_visible() else page.keyboard.press("Space")
    until(page, "!adverb.view.playing && Math.abs(adverb.shown.main.phase - adverb.view.phase) < 1e-3")
    page.wait_for_timeout(800)


def drag(page: Page, across: int, down: int) -> None:
    """Pause and drag the goal by some pixels; the button stays pressed."""
    pause_at_goal(page)
    x, y = page.evaluate("adverb.drawn.handle")
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 9):
        page.mouse.move(x + across * step / 8, y + down * step / 8)
        page.wait_for_timeout(40)
    page.wait_for_timeout(1500)


def compared(page: Page) -> None:
    """Pause with a comparison figure."""
    pause_at_goal(page)
    until(page, "adverb.shown.comparison !== null")
    page.wait_for_timeout(1000)


def crowd(page: Page) -> None:
    """Wait for all characters."""
    until(page, "adverb.shown.main.count === adverb.view.crowd")
    page.wait_for_timeout(1500)


def driven(page: Page) -> None:
    """Walk for some seconds in a curve."""
    page.keyboard.down("KeyW")
    page.wait_for_timeout(1500)
    page.keyboard.down("KeyA")
    page.wait_for_timeout(1000)


def climbed(page: Page) -> None:
    """Walk for two cycles."""
    page.wait_for_timeout(6000)


def pressed(*names: str) -> Act:
    """Press keys in order."""
    return lambda page: [page.keyboard.press(name) for name in names] and page.wait_for_timeout(400)


def opened(tab: str) -> Act:
    """Open a tab, which opens the sheet on a phone."""
    return lambda page: page.get_by_role("tab", name=tab).click() or page.wait_for_timeout(2500)


def unknown_verb(page: Page) -> None:
    """Wait for the notice of a link to an unknown verb."""
    page.get_by_text("does not exist on this server").wait_for()
    page.wait_for_timeout(800)


def states(service: Service, verbs: list[str]) -> Iterator[State]:
    """All screenshots in order; the last one is taken without a server."""
    for verb in (*BUILT_IN, *verbs):
        yield State(f"{verb}_playing", {"verb": verb})
        yield State(f"{verb}_paused", {"verb": verb}, lambda page: drag(page, 40, -40))
        yield State(f"{verb}_dark", {"verb": verb}, lambda page: drag(page, -30, 20), SMALL, "dark")
        yield State(f"{verb}_phone", {"verb": verb}, pause_at_goal, PHONE)
    yield State("marks", {"pseudo": "yes", "verb": "reach", **REACH}, pause_at_goal)
    yield State("readme", {"verb": "reach", "compare": "method:rbf"}, lambda page: drag(page, 46, -48))
    for scheme in ("light", "dark"):
        view = {"verb": "reach", "compare": "method:rbf", **REACH}
        yield State(f"compare_{scheme}", view, compared, WIDE, scheme)
        yield State(f"crowd_{scheme}", {"verb": "reach", "crowd": "200", "detail": "low"}, crowd, WIDE, scheme)
        yield State(f"drive_{scheme}", DRIVE, driven, WIDE, scheme)
        yield State(f"keys_{scheme}", {"verb": "reach"}, pressed("?"), SMALL, scheme)
        for panel in PANELS:
            opened_view = {"verb": "reach", "panel": panel}
            yield State(f"{panel}_{scheme}", opened_view, opened(panel.title()), WIDE, scheme)
        maps = {"verb": "reach", "panel": "quality", "map": "support", "maps": "corrected", **REACH}
        yield State(f"support_{scheme}", maps, pause_at_goal, WIDE, scheme)
    yield State("slope_up", {"verb": "walk", "at.slope": "10", "at.damage": "0.3"}, climbed)
    yield State("slope_down", {"verb": "walk", "at.slope": "-10", "at.damage": "0"}, climbed, SMALL, "dark")
    yield State("compare_arm3", {"verb": "arm3", "compare": "method:rbf"}, compared, SMALL)
    yield State("crowd_arm3", {"verb": "arm3", "crowd": "24"}, crowd, SMALL)
    yield State("drive_crowd", {**DRIVE, "crowd": "24", "detail": "low"}, driven)
    yield State("drive_phone", DRIVE, size=PHONE)
    yield State("focus", {"verb": "reach"}, pressed("Tab", "Tab"), SMALL)
    for tab in ("Verb", *map(str.title, PANELS)):
        yield State(f"sheet_{tab.lower()}", {"verb": "reach"}, opened(tab), PHONE)
    yield State("phone_dark", {"verb": "reach", "compare": "method:rbf"}, compared, PHONE, "dark")
    yield State("error", {"verb": "wave"}, unknown_verb, SMALL)
    yield State("error_phone", {"verb": "wave"}, unknown_verb, PHONE)
    yield State("loading", {"verb": "reach"}, size=SMALL, loads=False)
    gone = {"verb": "reach", **REACH}
    yield State("gone", gone, lambda page: (service.stop(), page.wait_for_timeout(2500)), SMALL)


def take(browser: Browser, url: str, state: State, folder: Path) -> None:
    """Open the page at a state and save its screenshot."""
    wide, high = state.size
    context = browser.new_context(
        viewport={"width": wide, "height": high},
        color_scheme="dark" if state.scheme == "dark" else "light",
        has_touch=state.size == PHONE,
    )
    page = context.new_page()
    page.on("pageerror", lambda err: sys.stderr.write(f"{state.name}: {err}\n"))
    if not state.loads:
        page.route("**/v1/**", lambda _: None)
    page.goto(f"{url}/#" + "&".join(f"{name}={value}" for name, value in state.view.items()))
    if state.loads:
        until(page, "document.documentElement.dataset.ready === 'true'")
        sys.stdout.write(f"{state.name}: first picture after {page.evaluate('performance.now()') / 1000:.2f} s\n")
    state.act(page)
    page.screenshot(path=folder / f"{state.name}.png")
    context.close()


def main() -> None:
    """Take the selected screenshots."""
    parser = argparse.ArgumentParser(description="Screenshots of the dashboard, one per state.")
    parser.add_argument("-o", "--out", type=Path, default=PROJECT / "build" / "screenshots", help="output folder")
    parser.add_argument("--only", default="", help="regular expression of state names")
    parser.add_argument("verbs", nargs="*", type=Path, metavar="VERB", help="additional verb files")
    args = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("no Chromium on the path; Debian's package `chromium` has it")
    args.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as data, sync_playwright() as playwright:
        service = Service(Path(data), args.verbs)
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        try:
            for state in states(service, [path.stem for path in args.verbs]):
                if re.search(args.only, state.name):
                    take(browser, service.url, state, args.out)
        finally:
            browser.close()
            service.stop()


if __name__ == "__main__":
    main()
