"""A crowd in the browser page: weights that are evaluated there, and streamed poses, in turns on one page.

``python -m benchmarks.page_crowd [--figures N] [--verb NAME] [--rounds N]``: build the page first (``make dashboard``).
It needs Chromium, starts a server on a free port of loopback, and prints bytes per second, processor time of the server
and pictures per second of each way, the median of the rounds.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import sys
from pathlib import Path
from typing import Any

from adverb_load.process import serve
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).parents[1]
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking"]
SETTLE_S, MEASURE_S, PATIENCE_S = 8.0, 8.0, 300.0
WAYS = {"weights": "no", "q48": "yes"}


def state(page: Page, expression: str) -> Any:
    """Value of an expression on the page's state; the content security policy forbids evaluated waits."""
    return json.loads(page.evaluate(f"JSON.stringify((({expression}) ?? null))"))


def until(page: Page, condition: str) -> None:
    """Wait for a condition."""
    for _ in range(int(PATIENCE_S / 0.1)):
        if page.evaluate(f"Boolean({condition})"):
            return
        page.wait_for_timeout(100)
    raise SystemExit(f"the page did not reach: {condition}")


def measure(page: Page, server: Any, url: str, figures: int) -> tuple[float, float, float]:
    """Bytes per second, processor time (share of a core) of the server, and pictures per second."""
    page.goto("about:blank")
    page.goto(url)
    until(page, f"globalThis.adverb?.shown.main?.count === {figures}")
    page.wait_for_timeout(1000 * SETTLE_S)
    before, drawn, rates = server.cpu_s(), state(page, "adverb.drawn.frames"), []
    for _ in range(int(MEASURE_S)):
        page.wait_for_timeout(1000)
        rates.append(state(page, "adverb.stats.bytesPerS"))
    used = (server.cpu_s() - before) / MEASURE_S
    return statistics.fmean(rates), used, (state(page, "adverb.drawn.frames") - drawn) / MEASURE_S


def main() -> None:
    """Measure, and print a row for each way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", type=int, default=2000)
    parser.add_argument("--verb", default="walk")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("Chromium is not installed")
    command = [sys.executable, "-c", "from service.cli import main; main()", "serve", "--port", "0"]
    environment = {"ADVERB_REFINERS": "0", "ADVERB_STREAM_CHANNELS": str(options.figures + 8)}
    rows: dict[str, list[tuple[float, float, float]]] = {way: [] for way in WAYS}
    with serve(command, core=None, cwd=ROOT, environment=environment) as server, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 640, "height": 400})
        for _ in range(options.rounds):
            for way, poses in WAYS.items():
                link = f"verb={options.verb}&crowd={options.figures}&detail=low&encoding=q48&crowdPoses={poses}"
                rows[way].append(measure(page, server, f"{server.base}/#{link}", options.figures))
                print(way, *(round(value, 3) for value in rows[way][-1]), file=sys.stderr, flush=True)
        browser.close()
    print(f"{options.figures} figures of '{options.verb}' in one page, {options.rounds} rounds of {MEASURE_S:g} s")
    for way, found in rows.items():
        size, used, pictures = (statistics.median(column) for column in zip(*found, strict=True))
        print(f"{way:8} {size / 1e3:9.1f} kB/s {100 * used:6.1f} % of a core {pictures:6.1f} pictures/s")


if __name__ == "__main__":
    main()
