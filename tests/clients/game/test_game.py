"""The game: its mathematics, and ten seconds of scripted clicks against a real server."""

import importlib.util
import math
import sys
import threading
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from adverb_client import quat
from adverb_load.process import serve

from tests.clients.game import GAME
from tests.clients.proxy import Proxy

pytestmark = pytest.mark.skipif(importlib.util.find_spec("pygame") is None, reason="pygame-ce is not installed")

PROJECT = Path(__file__).resolve().parents[3]
START = "from service.cli import main; main()"
SETTINGS = {"ADVERB_DATA": "", "ADVERB_STREAM_GRACE_S": "0.2"}
"""A session is soon forgotten, as by a restart of the server."""


@pytest.fixture
def modules(monkeypatch):
    """The modules of the game."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("SDL_AUDIODRIVER", "dummy")
    import actions
    import balls
    import fighter
    import game
    import match
    import placement

    return Mock(actions=actions, balls=balls, fighter=fighter, game=game, match=match, placement=placement)


@pytest.fixture(scope="module")
def address():
    command = [sys.executable, "-c", START, "serve", "--port", "0"]
    with serve(command, core=None, cwd=PROJECT, environment=SETTINGS) as found:
        yield found.base


def test_a_placement_brings_a_pose_into_the_world(modules):
    rng = np.random.default_rng(4)
    for yaw in (0.0, 1.2, -3.0):
        local_root, local = rng.normal(size=3), rng.normal(size=4)
        local /= np.linalg.norm(local)
        turn, shift = modules.placement.about_y(yaw), np.array([1.0, 0.0, -2.0])
        world_root, world = quat.rotate(turn, local_root) + shift, quat.mul(turn, local)
        found = modules.placement.Placement.between(world_root, world, local_root, local)
        assert found.yaw_rad == pytest.approx(yaw, abs=1e-9)
        np.testing.assert_allclose(found.shift, shift, atol=1e-9)
        np.testing.assert_allclose(found.local(world_root), local_root, atol=1e-9)
        np.testing.assert_allclose(found.world(local_root), world_root, atol=1e-9)


def test_a_ball_is_at_its_point_in_time(modules):
    ball = modules.balls.Ball(np.array([0.6, 1.5, 5.6]), np.array([-0.3, 1.2, 0.9]), 10.0, 12.5, soft=False)
    np.testing.assert_allclose(ball.position(10.0), ball.start)
    np.testing.assert_allclose(ball.position(12.5), ball.meet)
    assert ball.position(11.2)[1] > 1.5  # a lob
    assert ball.position(60.0)[1] == modules.balls.RADIUS_M  # on the ground
    ball.end(modules.balls.STRUCK, 12.5, ball.meet, np.array([0.0, 0.0, 4.0]))
    np.testing.assert_allclose(ball.position(12.5), ball.meet)
    assert ball.position(12.7)[2] > ball.meet[2] + 0.7
    np.testing.assert_allclose(ball.position(10.0), ball.start)  # what is shown later is the flight


def test_the_closest_approach_is_between_frames(modules):
    ball = modules.balls.Ball(np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0, 1.0, soft=True)
    ball.end(modules.balls.CAUGHT, 0.0, np.array([0.0, 1.0, 0.0]), np.zeros(3))  # it stands still
    points = np.array([[-1.0, 1.2, 0.0], [0.5, 1.2, 0.0]])
    miss_m, when_s, point = modules.balls.closest(np.array([2.0, 2.3]), points, ball)
    assert (miss_m, when_s) == (pytest.approx(0.2), pytest.approx(2.2))
    np.testing.assert_allclose(point, [0.0, 1.2, 0.0], atol=1e-12)
    assert modules.balls.closest(np.array([2.0]), points[:1], ball)[0] == pytest.approx(math.hypot(1.0, 0.2))


def test_the_verb_depends_on_the_ball(modules):
    choose, ball = modules.actions.choose, modules.balls.Ball
    for height, soft, verb in ((0.6, False, "kick"), (1.3, False, "punch"), (0.6, True, "reach")):
        point = np.array([0.0, height, 0.9])
        assert choose(ball(np.zeros(3), point, 0.0, 1.0, soft)) == verb
        stand, heading = modules.actions.stand_for(verb, point, np.array([0.0, 1.5, 5.0]))
        local = modules.placement.Placement(heading, stand).local(point)
        np.testing.assert_allclose(local[[0, 2]], modules.actions.PREFERRED[verb], atol=1e-9)


def test_points(modules):
    def result(miss_m, met):
        return modules.fighter.Result("punch", miss_m, 0.0, met, clamped=False)

    assert [modules.match.points_of(result(*row)) for row in ((0.0, True), (0.14, True), (0.0, False))] == [100, 10, 0]
    match = modules.match.Match(np.zeros(3))
    for miss_m, met in ((0.0, True), (0.0, True), (math.nan, False), (0.07, True)):
        ball = modules.balls.Ball(np.zeros(3), np.ones(3), 0.0, 1.0, soft=False)
        match.record(ball, result(miss_m, met))
    assert (match.score, match.met, match.combo) == (100 + 200 + 0 + 55, 3, 1)
    assert match.mean_miss_m == pytest.approx(0.07 / 3)


def test_game_time_stands_still_in_a_pause(modules):
    world = modules.game.World()
    assert world.pause(10.0)
    assert world.game_s(15.0) == 10.0
    assert not world.pause(16.0)
    assert world.game_s(17.0) == 11.0


@pytest.fixture
def play(modules, monkeypatch):
    """Plays the demonstration until a condition on its results holds after a throw, or for 90 s."""

    def started(url, holds, *options, then=lambda: None):
        import pygame

        results, record = [], modules.match.Match.record

        def watch(self, ball, result):
            record(self, ball, result)
            results.append(result)
            then()
            if holds(results):
                pygame.event.post(pygame.event.Event(pygame.QUIT))

        monkeypatch.setattr(modules.match.Match, "record", watch)
        found = modules.game.main(["--url", url, "--demo", "--seconds", "90", *options])
        assert holds(results), results
        return found

    return started


def closest_m(results):
    """Least distance that was measured in the poses that arrived; infinite if none was."""
    return min((result.miss_m for result in results if not math.isnan(result.miss_m)), default=math.inf)


def test_ten_seconds_of_clicks(modules, play, address, tmp_path):
    import pygame

    began_s, reach_m = time.monotonic(), modules.fighter.REACH_M

    def holds(results):
        played = time.monotonic() - began_s > 10.0
        return played and any(row.met for row in results) and closest_m(results) < reach_m

    found = play(address, holds, "--screenshots", str(tmp_path))
    assert found.score > 0
    assert found.met >= 1
    assert {result.verb for result in found.results} <= {"punch", "kick", "reach"}
    pictures = sorted(tmp_path.glob("*.png"))
    assert pictures
    image = pygame.image.load(pictures[0])
    assert image.get_size() == modules.game.SIZE
    colours = {tuple(image.get_at((x, y)))[:3] for x in range(300, 900, 5) for y in range(120, 600, 5)}
    assert len(colours) > 200  # a figure is drawn


def test_a_lost_session(modules, play, address):
    """The connection is cut for longer than the server keeps the session; later balls are met again."""
    proxy, cut = Proxy(int(address.rpartition(":")[2])), threading.Event()

    def lose():
        if not cut.is_set():
            cut.set()
            proxy.accepting = False
            proxy.cut()
            threading.Timer(1.5, setattr, (proxy, "accepting", True)).start()

    try:
        play(proxy.url, lambda results: closest_m(results[2:]) < modules.fighter.REACH_M, then=lose)
    finally:
        proxy.close()


def test_keys(modules, monkeypatch):
    """Pause, restart, help and leave."""
    import pygame

    pygame.display.init()
    pygame.display.set_mode((64, 64))
    try:
        world, fighter = modules.game.World(), Mock()
        for key in (pygame.K_h, pygame.K_r, pygame.K_p):
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
        pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=(5, 6), button=1))
        modules.game.handle_input(world, fighter)
        assert (world.helps, world.restart, world.since_s is not None) == (False, True, True)
        fighter.channel.set.assert_called_once_with(play=False)
        assert world.clicks == []  # nothing is thrown in a pause
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_p))
        pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=(5, 6), button=3))
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE))
        modules.game.handle_input(world, fighter)
        assert world.clicks == [((5, 6), True)]
        assert not world.running
    finally:
        pygame.quit()


def test_it_stands_alone():
    """It imports pygame, NumPy, the client and its own modules."""
    own = {path.stem for path in GAME.glob("*.py")}
    for path in GAME.glob("*.py"):
        lines = [line.split() for line in path.read_text().splitlines() if line.startswith(("from ", "import "))]
        assert {words[1].split(".")[0] for words in lines} - own - set(sys.stdlib_module_names) <= {
            "adverb_client",
            "numpy",
            "pygame",
        }, path.name
