"""A character whose hand follows the mouse: streamed poses, drawn 60 times a second.

    python game.py --url http://127.0.0.1:8000

Move the mouse to move the goal, turn the wheel to move it towards you or away, drag with the right button to look
around, press the space bar to let the motion play, Escape to leave. Needs pygame-ce. Without a screen:

    SDL_VIDEODRIVER=dummy python game.py --frames 120 --screenshot game.png
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import drawing
import numpy as np
import numpy.typing as npt
import pygame
from adverb_client import Channel, Sample, SyncStream

SIZE = (1080, 720)
NEAR_M = 0.01
TEXT, DIM = (236, 240, 248), (158, 168, 186)
GOOD, FAR, BAD = (120, 232, 150), (255, 196, 84), (255, 118, 96)  # there, on the way, out of reach


@dataclass
class World:
    """State that changes from frame to frame: camera, goal, last distances between hand and goal."""

    turn_rad: float = 0.55
    depth_m: float = 0.45
    goal: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    off_m: list[float] = field(default_factory=list)
    playing: bool = False
    grounds: dict[float, pygame.Surface] = field(default_factory=dict)

    def camera(self) -> drawing.Camera:
        """The camera of this frame."""
        way = np.array([math.sin(self.turn_rad), 0.16, math.cos(self.turn_rad)])
        target = np.array([0.0, 0.93, 0.1])
        return drawing.Camera(target + 3.3 * way, target, 1.42 * SIZE[1], SIZE)

    def ground(self) -> pygame.Surface:
        """The background; drawn again only after the camera has moved."""
        if self.turn_rad not in self.grounds:
            self.grounds = {self.turn_rad: pygame.Surface(SIZE)}
            drawing.draw_ground(self.grounds[self.turn_rad], self.camera())
        return self.grounds[self.turn_rad]


def steer(channel: Channel, world: World, mouse: tuple[float, float]) -> None:
    """Set the adverbs so that the hand follows the mouse; for other verbs, the first two adverbs."""
    adverbs = channel.info.adverbs
    low, high = np.array([adverb.min for adverb in adverbs]), np.array([adverb.max for adverb in adverbs])
    names = [adverb.name for adverb in adverbs]
    if names[:2] == ["x", "y"]:
        point = world.camera().on_plane(mouse, world.depth_m)
        goal = np.clip(point[: len(names)], low, high)
        world.goal = np.append(goal, np.zeros(3))[:3]
    else:
        goal = 0.5 * (low + high)
        goal[:2] = (low + (high - low) * [mouse[0] / SIZE[0], 1.0 - mouse[1] / SIZE[1]][: len(goal)])[:2]
    channel.aim(goal)


def circle(tick: int) -> tuple[float, float]:
    """A mouse position on a circle, for runs without a mouse."""
    angle = 2 * math.pi * tick / 240
    return SIZE[0] * (0.45 + 0.12 * math.cos(angle)), SIZE[1] * (0.42 + 0.16 * math.sin(angle))


def handle_input(channel: Channel, world: World) -> bool:
    """Handle keys and mouse; returns whether the game continues."""
    for event in pygame.event.get():
        if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
            return False
        if event.type == pygame.KEYDOWN and event.key == pygame.K_SPACE:
            world.playing = not world.playing
            channel.set(play=world.playing, loop=True)
            if not world.playing:
                channel.set(phase=reaching(channel))
        if event.type == pygame.MOUSEWHEEL:
            world.depth_m += 0.03 * event.y
        if event.type == pygame.MOUSEMOTION and event.buttons[2]:
            world.turn_rad -= 0.006 * event.rel[0]
    return True


def reaching(channel: Channel) -> float:
    """The phase at which the hand follows the goal: the middle of the ``follow`` range."""
    info = channel.info
    if info.follow is not None:
        return sum(info.follow) / 2
    inner = [phase for phase in info.keytimes.values() if 0.0 < phase < 1.0]
    return inner[0] if inner else 0.5


def draw(screen: pygame.Surface, channel: Channel, sample: Sample, world: World) -> None:
    """One frame of the world."""
    camera, skeleton = world.camera(), channel.skeleton
    screen.blit(world.ground(), (0, 0))
    if sample.root is not None and sample.rotations is not None:
        root, rotations = sample.root.astype(np.float64), sample.rotations.astype(np.float64)
        hand = skeleton.positions(root, rotations)[hand_of(channel)]
        world.off_m = [*world.off_m, float(np.linalg.norm(hand - world.goal))][-180:]
        parts = drawing.limbs_of(skeleton, root, rotations)
        drawing.draw_shadow(screen, camera, parts)
        drawing.draw_figure(screen, camera, parts)
    if [adverb.name for adverb in channel.info.adverbs][:2] == ["x", "y"]:
        near = bool(world.off_m) and world.off_m[-1] < NEAR_M
        drawing.draw_goal(screen, camera, world.goal, BAD if sample.clamped else GOOD if near else FAR)


def hand_of(channel: Channel) -> int:
    """The joint that follows the goal."""
    names = channel.skeleton.names
    return names.index("RightHand") if "RightHand" in names else len(names) - 1


def draw_texts(screen: pygame.Surface, stream: SyncStream, sample: Sample, world: World, fps: float) -> None:
    """Numbers on a dark panel, and the distance between hand and goal in the last three seconds."""
    stats, off_m = stream.stats, world.off_m[-1] if world.off_m else math.nan
    error = "–" if math.isnan(sample.error) else f"{1e3 * sample.error:.2f} mm"
    live = ("live", GOOD) if stream.live else ("reconnecting", BAD)
    rows = [
        ("Adverb", *live),
        ("goal", "out of reach" if sample.clamped else "within reach", BAD if sample.clamped else GOOD),
        ("hand to goal", f"{1e3 * off_m:.1f} mm", GOOD if off_m < NEAR_M else TEXT),
        ("error of the pose", error, TEXT),
        ("round trip", f"{1e3 * stream.clock.round_trip_s:.1f} ms", TEXT),
        ("pose age + delay", f"{1e3 * stream.age_s:.1f} + {1e3 * sample.delay_s:.1f} ms", TEXT),
        ("lost / dropped", f"{stats.missing} / {stats.dropped}", TEXT),
        ("frames per second", f"{fps:.0f}", TEXT),
    ]
    panel = pygame.Surface((310, 28 + 24 * len(rows) + 64), pygame.SRCALPHA)
    pygame.draw.rect(panel, (14, 17, 26, 190), panel.get_rect(), border_radius=12)
    font = font_of(15)
    for k, (name, value, colour) in enumerate(rows):
        panel.blit(font.render(name, True, DIM), (18, 16 + 24 * k))
        text = font.render(value, True, colour)
        panel.blit(text, (292 - text.get_width(), 16 + 24 * k))
    draw_curve(panel, pygame.Rect(18, 24 + 24 * len(rows), 274, 50), world.off_m)
    screen.blit(panel, (18, 18))


@lru_cache
def font_of(size: int) -> pygame.font.Font:
    """A font, looked up once."""
    return pygame.font.SysFont("dejavusans,arial", size)


def draw_curve(panel: pygame.Surface, place: pygame.Rect, off_m: list[float]) -> None:
    """Curve of the last distances between hand and goal, with a line at one centimetre."""
    pygame.draw.rect(panel, (30, 35, 48, 220), place, border_radius=6)
    highest = max([0.02, *off_m])
    level = place.bottom - 3 - round((place.height - 6) * NEAR_M / highest)
    pygame.draw.line(panel, (70, 90, 84), (place.left + 3, level), (place.right - 3, level))
    if len(off_m) > 1:
        across = np.linspace(place.left + 4, place.right - 4, 180)[-len(off_m) :]
        up = place.bottom - 4 - (place.height - 8) * np.array(off_m) / highest
        pygame.draw.aalines(panel, FAR, False, np.column_stack([across, up]).tolist())


def play(stream: SyncStream, options: argparse.Namespace) -> int:
    """Run the game; returns the number of frames with a pose."""
    channel = stream.open(options.verb, fps=60, half_life=0.06, play=False)
    channel.set(phase=reaching(channel))
    screen = pygame.display.set_mode(SIZE)
    pygame.display.set_caption(f"Adverb: {options.verb}")
    clock, world, shown, tick = pygame.time.Clock(), World(), 0, 0
    while handle_input(channel, world) and (options.frames is None or tick < options.frames):
        steer(channel, world, circle(tick) if options.frames is not None else pygame.mouse.get_pos())
        sample = channel.pose()
        if sample is not None:
            draw(screen, channel, sample, world)
            draw_texts(screen, stream, sample, world, clock.get_fps())
            shown += 1
        pygame.display.flip()
        clock.tick(60)
        tick += 1
    if options.screenshot is not None:
        pygame.image.save(screen, options.screenshot)
    return shown


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, connect and play; returns the number of frames with a pose."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="address of the server")
    parser.add_argument("--verb", default="reach", help="verb to play")
    parser.add_argument("--frames", type=int, help="stop after this number of frames; the goal moves on a circle")
    parser.add_argument("--screenshot", metavar="FILE", help="save the last frame as a picture")
    options = parser.parse_args(arguments)
    pygame.display.init()
    pygame.font.init()
    try:
        with SyncStream(options.url) as stream:
            return play(stream, options)
    finally:
        font_of.cache_clear()
        pygame.quit()


if __name__ == "__main__":
    main()
