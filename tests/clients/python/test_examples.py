"""The examples run, without a screen."""

import importlib.util
import sys
from pathlib import Path

from tests.clients.python.fake import running_aside

EXAMPLES = Path(__file__).parents[3] / "clients" / "python" / "examples"


def example(name: str, monkeypatch):
    """An example as a module, with its folder on the path."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


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
