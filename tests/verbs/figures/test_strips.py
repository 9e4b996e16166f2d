from dataclasses import replace

import numpy as np
import pytest

from tests.verbs.sources import arm_motion, example_row, write_source
from verbs import library
from verbs.authoring.fit import build
from verbs.figures import strips as module
from verbs.figures.strips import ACROSS, DOWN, examples_at, stands, strips, view_of


@pytest.fixture(scope="module")
def arm():
    return library.load("arm3")


@pytest.fixture(scope="module")
def reach():
    return library.load("reach")


def named(verb):
    return {strip.name: strip for strip in strips(verb)}


def test_a_verb_has_a_strip_through_time_one_for_each_adverb_and_a_grid(arm, reach):
    assert list(named(arm)) == ["time", "x", "y", "grid"]
    found = named(reach)
    assert list(found) == ["time", "x", "y", "z", "grid"]
    assert [len(found[name].cells) for name in found] == [ACROSS] * 4 + [(ACROSS - 2) * DOWN]


def test_keytimes_take_the_place_of_the_nearest_even_phases(arm):
    framed = {cell.label.split("\n")[1]: k for k, cell in enumerate(named(arm)["time"].cells) if cell.boxed}
    assert framed == {"start": 0, "reach": 4, "end": ACROSS - 1}


def test_the_pose_of_a_strip_reaches_its_goal(arm, reach):
    for verb in (arm, reach):
        for name, strip in named(verb).items():
            if name == "time":
                continue
            reached = [cell for cell in strip.cells if not cell.faint]
            assert len(reached) == len(strip.cells) - strip.clamped
            gaps = [np.linalg.norm(cell.points[verb.measure.effector] - cell.mark) for cell in reached]
            assert max(gaps) < 1e-6
            assert strip.error == pytest.approx(max(gaps), abs=1e-9)


def test_clamped_cells_are_pale_and_never_framed(reach):
    for strip in strips(reach):
        pale = [cell for cell in strip.cells if cell.faint]
        assert len(pale) == strip.clamped
        assert not any(cell.boxed for cell in pale)
    assert named(reach)["grid"].clamped


def test_frames_of_the_grid_are_where_the_examples_are(arm):
    """The nine examples of the arm are a regular grid: low, level and high at near, middle and far."""
    grid = named(arm)["grid"]
    marks = np.array([cell.mark[:2] for cell in grid.cells])
    expected = {int(np.argmin(np.linalg.norm(marks - value, axis=1))) for value in arm.values}
    assert {k for k, cell in enumerate(grid.cells) if cell.boxed} == expected
    assert len(expected) == 9


def test_an_example_away_from_a_strip_frames_no_cell():
    cells = np.stack([np.linspace(0.0, 1.0, 5), np.full(5, 0.5)], axis=1)
    values = np.array([[0.0, 0.0], [0.3, 0.5], [1.0, 1.0], [0.9, 0.6]])
    assert examples_at(values, cells, (0,)) == [1, 4]
    assert examples_at(values, cells, (0,), np.arange(5) == 4) == [1]


def test_a_grid_lies_as_its_goals_do_on_the_screen(arm, reach):
    for verb in (arm, reach):
        grid = named(verb)["grid"]
        frame = module.screen_axes(view_of(verb))
        marks = np.array([cell.mark @ frame.T for cell in grid.cells]).reshape(DOWN, grid.columns, 3)
        assert np.all(np.diff(marks[..., 0], axis=1) > 0), "to the right"
        assert np.all(np.diff(marks[..., 1], axis=0) < 0), "the highest row first"
        assert (len(grid.heads), len(grid.sides)) == (grid.columns, DOWN)


def test_the_view_suits_the_skeleton_and_the_action(arm, reach, verb_of):
    assert view_of(arm) == (0.0, 0.0), "a planar arm is seen along the normal of its plane"
    assert -45 < view_of(reach)[0] < -30, "from the front, toward the side of the right hand"
    assert view_of(verb_of("reach_left"))[0] == -view_of(reach)[0]
    for name in ("jump", "locomotion", "kick"):
        assert view_of(verb_of(name))[0] < -50, "from the side"


def test_a_planar_arm_does_not_stand_on_the_ground(arm, reach):
    on = {verb.name: stands(np.array([cell.points for cell in named(verb)["y"].cells])) for verb in (arm, reach)}
    assert on == {"arm3": False, "reach": True}


def test_looping_verbs_show_the_path_of_the_root(verb_of):
    found = named(verb_of("locomotion"))
    lengths = [np.linalg.norm(cell.path[-1] - cell.path[0]) for cell in found["forward_speed"].cells]
    speeds = [float(cell.label.split()[0]) for cell in found["forward_speed"].cells]
    np.testing.assert_allclose(np.array(lengths) / 0.25, speeds, atol=0.45)  # the speed varies over a cycle
    assert all(cell.path is not None and np.all(cell.path[:, 1] == 0) for cell in found["time"].cells)


def test_travelling_figures_stay_in_the_middle_of_their_cells(verb_of):
    for strip in strips(verb_of("jump")):
        roots = np.array([cell.points[0, [0, 2]] for cell in strip.cells])
        np.testing.assert_allclose(roots, 0.0, atol=1e-9)


def test_goals_around_the_body_have_a_grid_over_angle_and_height(verb_of):
    kick = verb_of("kick")
    grid = named(kick)["grid"]
    assert grid.heads[0].startswith("angle")
    assert [side.split()[0] for side in grid.sides] == ["y"] * DOWN
    assert grid.clamped < len(grid.cells) / 2 + 3
    assert grid.error < 1e-6


def test_one_style_adverb_has_a_strip_without_goals_and_no_grid(tmp_path):
    motions = {f"bend{k}": arm_motion(0.2 + 0.3 * k, 0.5) for k in range(3)}
    rows = [example_row(name, [0.0, 0.5, 1.0], [k]) for k, name in enumerate(motions)]
    head = (
        'name = "bend"\nmeasure = "none"\nkeytime_names = ["start", "top", "end"]\n'
        '[[adverb]]\nname = "depth"\nunit = ""\nstyle = true\n'
    )
    found = named(build(write_source(tmp_path / "bend", motions, rows, head)).verb)
    assert list(found) == ["time", "depth"]
    assert {k for k, cell in enumerate(found["depth"].cells) if cell.boxed} == {0, 4, 8}
    assert all(cell.mark is None for cell in found["depth"].cells)
    assert np.isnan(found["depth"].error)


def test_adverbs_named_as_the_other_strips_have_names_of_their_own(arm):
    odd = replace(
        arm, adverbs=tuple(replace(one, name=name) for one, name in zip(arm.adverbs, ("time", "grid"), strict=True))
    )
    assert list(named(odd)) == ["time", "along_time", "along_grid", "grid"]


@pytest.mark.parametrize(("unit", "text"), [("none", "0.50"), ("deg", "0.50°"), ("m", "0.50 m"), ("", "0.50")])
def test_values_have_their_unit_if_they_have_one(arm, unit, text):
    adverb = replace(arm.adverbs[0], unit=unit, minimum=0.0, maximum=1.0)
    assert module._value(replace(arm, adverbs=(adverb, arm.adverbs[1])), 0, 0.5, bare=True) == text
