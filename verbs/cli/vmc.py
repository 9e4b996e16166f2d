"""Command ``vmc``."""

from __future__ import annotations

import socket
import time
from typing import Annotated, Any

import typer

from verbs.cli.options import MethodOption, Plant, open_verb, parse_at
from verbs.cli.output import err, plain
from verbs.errors import RequestError

__all__ = ["vmc_command"]


def vmc_command(
    verb: Annotated[str, typer.Option("--verb", help="A built-in name, a .verb file, or a source folder.")],
    to: Annotated[str, typer.Option("--to", metavar="HOST:PORT", help="Receiver; its default port is 39539.")],
    at: Annotated[str, typer.Option("--at", metavar="NAME=VALUE,…", help="Adverbs. Default: the middle.")] = "",
    wander: Annotated[
        float | None, typer.Option(min=0.1, max=3600, metavar="SECONDS", help="Go to another example so often.")
    ] = None,
    fps: Annotated[float, typer.Option(min=1, max=240, help="Poses per second.")] = 60.0,
    speed: Annotated[float, typer.Option(min=-10, max=10, help="Speed of the motion; negative is backwards.")] = 1.0,
    seconds: Annotated[float | None, typer.Option(min=0, help="Time after which to end. Default: Ctrl-C.")] = None,
    method: MethodOption = None,
    plant: Plant = True,
) -> None:
    """Send a verb in real time to programs that receive VMC, the Virtual Motion Capture protocol (UDP).

    The skeleton must be a humanoid. The motion starts over at its end.

    Example: [bold]adverb vmc --verb reach --at x=-0.3,y=1.2,z=0.4 --to 127.0.0.1:39539[/]
    """
    import numpy as np

    from verbs.io.vmc import VmcPackets, address_of
    from verbs.runtime.characters import Characters
    from verbs.runtime.evaluate import Evaluator

    evaluator = Evaluator(open_verb(verb))
    packets = VmcPackets(evaluator.verb.skeleton)
    characters = Characters(evaluator, method)
    slot = characters.add(parse_at(at) or None, speed=speed, looping=True, plant=plant)
    slots, rng, examples = np.array([slot]), np.random.default_rng(), evaluator.verb.values
    family, address = address_of(to)
    with socket.socket(family, socket.SOCK_DGRAM) as sender:
        err.print(f"{plain(evaluator.verb.name)} to {plain(to)}: {len(packets.bones)} bones, {fps:g} poses a second")
        began_s, sent, wander_s = time.monotonic(), 0, wander
        while seconds is None or sent < seconds * fps:
            if wander_s is not None and wander is not None and sent >= wander_s * fps:
                characters.aim(slot, evaluator.check(examples[rng.integers(len(examples))][None])[0])
                wander_s += wander
            frames = characters.step(slots, 1.0 / fps)
            time.sleep(max(0.0, began_s + sent / fps - time.monotonic()))
            for packet in packets.pack(frames.root[0], frames.rotations[0], sent / fps):
                _send(sender, packet, address, to)
            sent += 1


def _send(sender: socket.socket, packet: bytearray, address: Any, to: str) -> None:
    try:
        sender.sendto(packet, address)
    except ConnectionRefusedError:
        pass  # nothing receives yet; it may be started later
    except OSError as problem:
        raise RequestError(f"nothing can be sent to {to:.100}: {problem.strerror or problem}") from problem
