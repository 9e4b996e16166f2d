"""The examples run, without a screen."""

import importlib.util
import sys
from pathlib import Path

import pytest

from tests.clients.python.fake import VERBS, FakeVerb, running_aside

EXAMPLES = Path(__file__).parents[3] / "clients" / "python" / "examples"


def example(name: str, monkeypatch):
    """An example as a module, with its folder on the path."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)  # dataclasses look their module up
    monkeypatch.delitem(sys.modules, "drawing", raising=False)
    spec.loader.exec_module(module)
    return module


def person() -> FakeVerb:
    names = ["Hips", "Spine", "Neck", "Head", "RightArm", "RightForeArm", "RightHand", "LeftUpLeg", "LeftToeBase"]
    offsets = [[0, 0, 0], [0, 0.3, 0], [0, 0.3, 0], [0, 0.1, 0], [-0.2, 0, 0], [-0.3, 0, 0], [-0.25, 0, 0], [0.1, 0, 0]]
    parents = [-1, 0, 1, 2, 1, 4, 5, 0, 7]
    return FakeVerb(VERBS["reach"].adverbs, names, parents, [*offsets, [0, -0.8, 0.1]])


@pytest.mark.parametrize("verb", ["reach", "board"])
def test_the_game_draws_frames_without_a_screen(verb, monkeypatch, tmp_path):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    import pygame

    picture = tmp_path / "game.png"
    with running_aside({"reach": person(), "board": VERBS["board"]}) as (fake, _):
        game = example("game", monkeypatch)
        arguments = ["--url", fake.url, "--verb", verb, "--frames", "30", "--screenshot", str(picture)]
        assert game.main(arguments) > 10
        assert any(isinstance(row, tuple) for row in fake.messages)  # the goal was sent
        assert fake.received("set")[0]["phase"] == pytest.approx(0.5)  # the middle of the phases that follow
    image = pygame.image.load(picture)
    assert image.get_size() == game.SIZE
    middle = {tuple(image.get_at((x, y)))[:3] for x in range(380, 700, 4) for y in range(120, 620, 4)}
    assert len(middle) > 200  # a figure is drawn


def test_the_follow_example_prints_a_report(monkeypatch, capsys):
    with running_aside() as (fake, _):
        follow = example("follow", monkeypatch)
        monkeypatch.setattr(sys, "argv", ["follow.py", "--url", fake.url, "--seconds", "0.6"])
        follow.main()
    lines = capsys.readouterr().out.splitlines()
    assert "error 250.000 mm" in lines[0]
    assert lines[-1].endswith("0 missing, 0 dropped")


def test_the_crowd_example_steers_with_one_message_a_frame(monkeypatch, capsys):
    with running_aside() as (fake, _):
        crowd = example("crowd", monkeypatch)
        arguments = ["--url", fake.url, "--characters", "12", "--seconds", "1", "--budget-kbps", "500"]
        monkeypatch.setattr(sys, "argv", ["crowd.py", *arguments])
        crowd.main()
    steered = [row for row in fake.messages if isinstance(row, tuple)]
    assert all(row[0] == 0x11 and len(row[2]) == 12 for row in steered)
    assert 0 < len(steered) <= crowd.FPS
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("error at most 250.000 mm")
    assert lines[1] == "  budget: 250 of 500 kbps, 40 left out, 6 to 60 fps"
