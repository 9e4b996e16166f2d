"""Let a character's hand follow a circle: stream poses, move the goal, print the error and the lateness.

python follow.py --url http://127.0.0.1:8000 --seconds 5
"""

from __future__ import annotations

import argparse
import asyncio
import math

import numpy as np
from adverb_client import Channel, Stream


async def follow(url: str, verb: str, seconds: float) -> None:
    """Stream for some seconds; print a report twice per second."""
    async with Stream(url) as stream:
        channel = await stream.open(verb, fps=60, half_life=0.05, play=False)
        if channel.info.follow is not None:  # at these phases the effector of a held channel is on the goal
            channel.set(phase=sum(channel.info.follow) / 2)
        low = np.array([adverb.min for adverb in channel.info.adverbs])
        high = np.array([adverb.max for adverb in channel.info.adverbs])
        middle, reach = 0.5 * (low + high), 0.25 * (high - low)
        began = stream.now()
        for tick in range(int(seconds * 60)):
            angle = 2 * math.pi * tick / 180
            around = np.zeros(len(middle))
            around[:2] = [math.cos(angle), math.sin(angle)][: len(around)]
            channel.aim(middle + reach * around)
            if tick % 30 == 29:
                print(report(stream, channel))
            await asyncio.sleep(max(0.0, began + tick / 60 - stream.now()))
        stats = stream.stats
        print(
            f"{stats.messages} messages, {stats.bytes / 1e3:.0f} kB, {stats.missing} missing, {stats.dropped} dropped"
        )


def report(stream: Stream, channel: Channel) -> str:
    """The state of the stream in one line."""
    sample = channel.pose()
    if sample is None:
        return "no frame yet"
    error = "not measured" if math.isnan(sample.error) else f"{1e3 * sample.error:7.3f} mm"
    return (
        f"phase {sample.phase:.2f}  error {error}  "
        f"age {1e3 * stream.age_s:5.1f} ms  lateness {1e3 * stream.lateness_s:5.1f} ms  "
        f"display delay {1e3 * sample.delay_s:5.1f} ms  round trip {1e3 * stream.clock.round_trip_s:.1f} ms"
    )


def main() -> None:
    """Read the command line and follow."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="address of the server")
    parser.add_argument("--verb", default="reach", help="verb to stream")
    parser.add_argument("--seconds", type=float, default=5.0, help="duration")
    options = parser.parse_args()
    asyncio.run(follow(options.url, options.verb, options.seconds))


if __name__ == "__main__":
    main()
