"""A crowd whose hands follow moving goals: one message steers all characters.

    python crowd.py --url http://127.0.0.1:8000 --characters 200 --budget-kbps 4000

Characters stand in a square. Goals circle in the reach of each; the camera is at one side, so with a budget the
characters near it get most frames. Prints what arrived, once a second.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from adverb_client import BudgetReport, Channel, SyncStream

FPS = 30
CAMERA = (0.0, 1.7, -6.0)


def goals_of(channels: list[Channel]) -> Iterator[npt.NDArray[np.float64]]:
    """Goals (B, D) of each frame: ellipses in the middle half of each adverb's range, all phases different."""
    adverbs = channels[0].info.adverbs
    low, high = np.array([adverb.min for adverb in adverbs]), np.array([adverb.max for adverb in adverbs])
    shifts = np.linspace(0.0, 2 * np.pi, len(channels), endpoint=False)[:, None] + 1.5 * np.arange(len(adverbs))
    frame = 0
    while True:
        yield 0.5 * (low + high) + 0.25 * (high - low) * np.sin(shifts + frame * np.pi / FPS)
        frame += 1


def play(stream: SyncStream, options: argparse.Namespace) -> int:
    """Steer the crowd for some seconds; returns the number of received records."""
    channels = [
        stream.open(options.verb, fps=FPS, encoding="q32", loop=True, half_life=0.05, events=False)
        for _ in range(options.characters)
    ]
    numbers = np.array([channel.number for channel in channels])
    stream.view(CAMERA, budget_kbps=options.budget_kbps)
    goals, start_s = goals_of(channels), time.monotonic()
    for frame in range(round(options.seconds * FPS)):
        stream.aim_many(numbers, next(goals))  # (B, D), one message
        if frame % FPS == FPS - 1:
            report(stream, channels)
        time.sleep(max(0.0, start_s + (frame + 1) / FPS - time.monotonic()))
    return stream.stats.records


def report(stream: SyncStream, channels: list[Channel]) -> None:
    """Print rates, and the errors of the poses that are shown now."""
    errors = [sample.error for channel in channels if (sample := channel.pose()) is not None]
    stats, error_mm = stream.stats, 1e3 * max(errors, default=float("nan"))
    print(f"{stats.records} records, {stats.bytes / 1e6:.2f} MB, error at most {error_mm:.3f} mm")
    for event in stream.take_events():
        if isinstance(event, BudgetReport):
            rates = f"{event.min_fps:.0f} to {event.max_fps:.0f} fps"
            print(f"  budget: {event.kbps:.0f} of {event.budget_kbps:.0f} kbps, {event.left_out} left out, {rates}")


def main() -> None:
    """Parse the command line, connect and play."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="address of the server")
    parser.add_argument("--verb", default="reach", help="verb of all characters")
    parser.add_argument("--characters", type=int, default=200, help="number of characters (%(default)s)")
    parser.add_argument("--budget-kbps", type=float, help="limit of pose messages, 1000 bit/s (none)")
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to play (%(default)s)")
    options = parser.parse_args()
    with SyncStream(options.url) as stream:
        play(stream, options)


if __name__ == "__main__":
    main()
