"""Target practice: throw balls at a figure, which walks to them, punches, kicks or catches them.

    python game.py --url http://127.0.0.1:8000

Left click throws a ball that is struck, right click a soft one that is caught. The figure is one channel of a stream:
it switches between verbs, aims at the predicted meeting point, and what it misses by is measured in the poses that
arrive. Needs pygame-ce. Without a screen, with thrown balls from a script:

    SDL_VIDEODRIVER=dummy python game.py --demo --seconds 10 --screenshots shots
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import drawing
import hud
import numpy as np
import numpy.typing as npt
import pygame
from adverb_client import Client, SyncStream
from balls import CAUGHT, FLYING, RADIUS_M, STRUCK, Ball
from fighter import Fighter, Result
from match import Match

F64 = npt.NDArray[np.float64]

SIZE = (1180, 720)
THROWER = np.array([0.6, 1.5, 5.6])
STRIKE, SOFT, GONE = (222, 84, 66), (84, 190, 120), (120, 124, 136)
LOW_M, HIGH_M, WIDE_M, DEPTH_M = 0.5, 1.6, 2.2, 0.9

DEMO = ((0.6, -0.1, 1.25, False), (3.4, 0.75, 1.2, True), (6.2, 0.3, 0.62, False))
"""Throws of the demo: seconds, x, y, whether soft; repeated."""
DEMO_S = 8.4


@dataclass
class World:
    """State of the window: camera, time, what is shown."""

    turn_rad: float = 0.0
    depth_m: float = DEPTH_M
    paused_s: float = 0.0
    since_s: float | None = None
    shown_s: float = 0.0
    helps: bool = True
    running: bool = True
    restart: bool = False
    clicks: list[tuple[tuple[int, int], bool]] = field(default_factory=list)
    grounds: dict[float, pygame.Surface] = field(default_factory=dict)

    def game_s(self, clock_s: float) -> float:
        """Game time of a time on the clock: it stands still while the game is paused."""
        return (clock_s if self.since_s is None else min(clock_s, self.since_s)) - self.paused_s

    def pause(self, now_s: float) -> bool:
        """Pause or continue; returns whether the game is paused now."""
        if self.since_s is None:
            self.since_s = now_s
            return True
        self.paused_s += now_s - self.since_s
        self.since_s = None
        return False

    def camera(self) -> drawing.Camera:
        """The camera of this frame."""
        way = np.array([math.sin(0.12 + self.turn_rad), 0.2, math.cos(0.12 + self.turn_rad)])
        target = np.array([0.1, 0.85, 0.3])
        return drawing.Camera(target + 5.2 * way, target, 1.5 * SIZE[1], SIZE)

    def ground(self) -> pygame.Surface:
        """The background; drawn again only after the camera has moved."""
        if self.turn_rad not in self.grounds:
            self.grounds = {self.turn_rad: pygame.Surface(SIZE)}
            drawing.draw_ground(self.grounds[self.turn_rad], self.camera())
        return self.grounds[self.turn_rad]

    def target(self, pixel: tuple[int, int]) -> F64:
        """Where a ball thrown at a pixel is to be met (3,): on the upright plane at the chosen depth."""
        point = self.camera().on_plane(pixel, self.depth_m)
        return np.array([np.clip(point[0], -WIDE_M, WIDE_M), np.clip(point[1], LOW_M, HIGH_M), self.depth_m])


def handle_input(world: World, fighter: Fighter) -> None:
    """Handle keys and mouse."""
    for event in pygame.event.get():
        if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
            world.running = False
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_p:
            fighter.channel.set(play=not world.pause(time.monotonic()))
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_r:
            world.restart = True
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_h:
            world.helps = not world.helps
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button in (1, 3) and world.since_s is None:
            world.clicks.append((event.pos, event.button == 3))
        elif event.type == pygame.MOUSEWHEEL:
            world.depth_m = float(np.clip(world.depth_m + 0.1 * event.y, 0.3, 2.2))
    keys = pygame.key.get_pressed()
    turn = 0.02 * (int(keys[pygame.K_RIGHT]) - int(keys[pygame.K_LEFT]))
    if turn:
        world.turn_rad = float(np.clip(world.turn_rad + turn, -1.2, 1.2))


def draw(screen: pygame.Surface, world: World, fighter: Fighter, match: Match, fps: float) -> None:
    """One frame of the game."""
    camera, sample = world.camera(), fighter.sample()
    screen.blit(world.ground(), (0, 0))
    offset_s = fighter.stream.clock.offset_s
    shown_s = world.game_s(time.monotonic())
    if sample is not None and not math.isnan(offset_s):
        shown_s = world.game_s(sample.server_time_s - offset_s)  # balls are shown at the time of the pose
    world.shown_s = shown_s
    for ball in match.balls:
        drawing.draw_ball_shadow(screen, camera, ball.position(shown_s), RADIUS_M)
        if ball.state == FLYING:
            drawing.draw_ring(screen, camera, ball.meet, 1.3 * RADIUS_M, SOFT if ball.soft else STRIKE)
    near = float(np.linalg.norm(camera.eye - fighter.position))
    behind = [b for b in match.balls if np.linalg.norm(camera.eye - b.position(shown_s)) > near]
    _balls(screen, camera, behind, shown_s)
    if sample is not None and sample.root is not None and sample.rotations is not None:
        root, rotations = sample.root.astype(np.float64), sample.rotations.astype(np.float64)
        parts = drawing.limbs_of(fighter.channel.skeleton, root, rotations)
        drawing.draw_shadow(screen, camera, parts)
        drawing.draw_figure(screen, camera, parts)
    _balls(screen, camera, [b for b in match.balls if b not in behind], shown_s)
    for when_s, point, text, good in match.notes:
        if when_s > shown_s:
            continue  # it is not shown yet
        rise = np.array([0.0, 0.4 + 0.25 * (shown_s - when_s), 0.0])
        words = hud.font_of(24).render(text, True, hud.GOOD if good else hud.BAD)
        screen.blit(words, words.get_rect(center=camera.project(point + rise)[:2].astype(int).tolist()))
    hud.draw_stream(screen, fighter, sample, fps)
    hud.draw_score(screen, match, fighter)
    if world.helps:
        hud.draw_help(screen)
    if world.since_s is not None:
        hud.draw_banner(screen, "paused")
    elif not fighter.stream.live:
        hud.draw_banner(screen, "reconnecting")


def _balls(screen: pygame.Surface, camera: drawing.Camera, balls: list[Ball], now_s: float) -> None:
    for ball in balls:
        colour = SOFT if ball.soft else STRIKE
        if ball.state not in (FLYING, STRUCK, CAUGHT):
            colour = GONE
        drawing.draw_ball(screen, camera, ball.position(now_s), RADIUS_M, colour)


class Demo:
    """Clicks by a script, for runs without a mouse."""

    def __init__(self, start_s: float) -> None:
        self._start_s, self._next = start_s, 0

    def click(self, now_s: float, camera: drawing.Camera) -> None:
        """Post the click that is due."""
        turn, number = divmod(self._next, len(DEMO))
        when_s, x, y, soft = DEMO[number]
        if now_s - self._start_s >= turn * DEMO_S + when_s:
            self._next += 1
            pixel = camera.project(np.array([x, y, DEPTH_M]))[:2].round().astype(int).tolist()
            pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=tuple(pixel), button=3 if soft else 1))


def play(stream: SyncStream, client: Client, options: argparse.Namespace) -> Match:
    """Run the game; returns its state at the end."""
    world = World()
    match = Match(THROWER)

    def record(ball: Ball, result: Result) -> None:
        match.record(ball, result)  # of the current match, also after a restart

    fighter = Fighter(stream, client, THROWER, world.game_s, record)
    screen = pygame.display.set_mode(SIZE)
    pygame.display.set_caption("Adverb: target practice")
    clock, start_s = pygame.time.Clock(), time.monotonic()
    demo = Demo(start_s) if options.demo else None
    shots = Shots(options.screenshots)
    try:
        while world.running and (options.seconds is None or time.monotonic() - start_s < options.seconds):
            if demo is not None:
                demo.click(time.monotonic(), world.camera())
            handle_input(world, fighter)
            now_s = world.game_s(time.monotonic())
            if world.restart:
                match, world.restart = Match(THROWER), False
            for pixel, soft in world.clicks:
                match.throw(world.target(pixel), now_s, fighter, soft=soft)
            world.clicks.clear()
            if world.since_s is None and stream.live:
                fighter.update(now_s, match.balls)
                match.update(now_s)
            draw(screen, world, fighter, match, clock.get_fps())
            shots.take(screen, match, world.shown_s)
            pygame.display.flip()
            clock.tick(60)
    finally:
        fighter.close()
    return match


class Shots:
    """Pictures, one of each ball that is met."""

    def __init__(self, folder: Path | None) -> None:
        self._folder, self._seen = folder, 0

    def take(self, screen: pygame.Surface, match: Match, shown_s: float) -> None:
        """Save a picture when the moment of the next result is shown."""
        if self._folder is None or len(match.results) <= self._seen:
            return
        result = match.results[self._seen]
        if not shown_s < result.when_s:
            self._seen += 1
            self._folder.mkdir(parents=True, exist_ok=True)
            pygame.image.save(screen, str(self._folder / f"{self._seen}-{result.verb}.png"))


def main(arguments: Sequence[str] | None = None) -> Match:
    """Parse the command line, connect and play; returns the state at the end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="address of the server (%(default)s)")
    parser.add_argument("--key", help="API key")
    parser.add_argument("--demo", action="store_true", help="throw balls by a script")
    parser.add_argument("--seconds", type=float, help="stop after this time")
    parser.add_argument("--screenshots", type=Path, metavar="FOLDER", help="save a picture of each ball that is met")
    options = parser.parse_args(arguments)
    pygame.display.init()
    pygame.font.init()
    try:
        with (
            Client(options.url, api_key=options.key) as client,
            SyncStream(options.url, api_key=options.key, reconnect_timeout_s=3_600.0) as stream,
        ):
            return play(stream, client, options)
    finally:
        hud.font_of.cache_clear()
        pygame.quit()


if __name__ == "__main__":
    found = main()
    sys.stdout.write(f"score {found.score}: {found.met} of {len(found.results)} balls met\n")
