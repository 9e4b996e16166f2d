"""Characters whose records need not be sent are not stepped, and nothing else differs."""

import numpy as np
import pytest

from service.stream.rest import KEY_S, Rest
from verbs import Evaluator, library
from verbs.runtime.characters import Characters

STEP_S = 1 / 60
NEVER = np.array([0])
"""No events are wanted."""


class Pair:
    """Two characters in the same state, of which one may rest."""

    def __init__(self, verb, **options):
        self.characters = Characters(Evaluator(library.load(verb)))
        self.rest = Rest(self.characters)
        self.resting, self.stepped = (np.array([self.characters.add(**options)]) for _ in range(2))
        self.steps = 0

    def tick(self, count=1, wanted=NEVER):
        for _ in range(count):
            if len(self.rest.choose(self.resting, np.array([True]), wanted, STEP_S)):
                self.characters.advance(self.resting, STEP_S)
                self.steps += 1
            self.characters.advance(self.stepped, STEP_S)

    def each(self, function):
        for slots in (self.resting, self.stepped):
            function(int(slots[0]))

    def same(self):
        """Assert that both are in the same state, up to rounding."""
        crowd = self.characters.crowd
        for name in ("phase", "seconds", "x", "z", "playing", "share", "phase_1", "phase_2", "step_s"):
            ours, other = (crowd.state[name][slots[0]] for slots in (self.resting, self.stepped))
            np.testing.assert_allclose(ours, other, atol=1e-5 if name in "xz" else 1e-9, err_msg=name)
        for name in ("shown", "velocity", "goals", "seen"):
            ours, other = (getattr(crowd, name)[slots[0]] for slots in (self.resting, self.stepped))
            np.testing.assert_allclose(ours, other, atol=1e-12, err_msg=name)
        ours, other = (
            crowd.weights[slots[0], crowd.state["weights"][slots[0]]] for slots in (self.resting, self.stepped)
        )
        np.testing.assert_allclose(ours, other, atol=1e-12)


def test_a_cycle_at_a_constant_goal_is_stepped_for_its_key_records_only():
    pair = Pair("locomotion", adverbs={"forward_speed": 1.3, "turn_rate": 0.4, "sideways_speed": 0.0}, phase=0.3)
    pair.tick(600)
    assert 10 / KEY_S <= pair.steps <= 12
    pair.tick(37)
    pair.rest.wake(int(pair.resting[0]), STEP_S)
    pair.same()


def test_a_goal_ends_the_rest():
    pair = Pair("locomotion", adverbs={"forward_speed": 1.3, "turn_rate": 0.4, "sideways_speed": 0.0})
    pair.tick(100)
    row = pair.characters.row({"forward_speed": 0.4, "turn_rate": -0.2, "sideways_speed": 0.0})
    pair.each(lambda slot: pair.characters.aim(slot, row))
    for _ in range(30):
        pair.tick()
        pair.same()
    assert pair.steps > 30


@pytest.mark.parametrize("change", [{"speed": -0.7}, {"playing": False}, {"phase": 0.6}, {"looping": False}])
def test_a_setting_ends_the_rest(change):
    pair = Pair("locomotion", adverbs={"forward_speed": 1.3, "turn_rate": 0.4, "sideways_speed": 0.0})
    pair.tick(100)
    pair.rest.wake(int(pair.resting[0]), STEP_S)
    pair.each(lambda slot: pair.characters.set(slot, **change))
    before = pair.steps
    pair.tick()
    assert pair.steps == before + 1
    pair.same()


def test_a_motion_that_ends_is_stepped_until_it_has_ended():
    pair = Pair("punch", phase=0.5)
    for _ in range(300):
        pair.tick()
        if pair.characters.state["playing"][pair.resting[0]]:
            pair.same()
    assert not pair.characters.state["playing"][pair.resting[0]]
    before = pair.steps
    pair.tick(60)
    assert pair.steps <= before + 1


def test_a_paused_pose_that_follows_its_goal_rests_once_it_is_there():
    pair = Pair("reach", adverbs={"x": -0.2, "y": 1.2, "z": 0.5}, phase=0.3, playing=False, following=True)
    pair.tick(60)
    pair.rest.wake(int(pair.resting[0]), STEP_S)
    pair.each(lambda slot: pair.characters.set(slot, phase=0.5))
    row = pair.characters.row({"x": -0.1, "y": 1.1, "z": 0.45})
    pair.each(lambda slot: pair.characters.aim(slot, row))
    for _ in range(20):
        pair.tick()
        pair.same()
    pair.tick(200)
    before = pair.steps
    pair.tick(60)
    assert pair.steps <= before + 1
    assert pair.characters.state["share"][pair.resting[0]] == 1.0


def test_events_of_a_cycle_are_not_missed():
    pair = Pair("locomotion")
    pair.tick(60, wanted=np.array([1]))
    assert pair.steps == 60


def test_a_removed_character_leaves_nothing():
    pair = Pair("locomotion")
    pair.tick(60)
    slot = int(pair.resting[0])
    pair.rest.forget(slot)
    pair.characters.remove(slot)
    assert pair.characters.add() == slot
    assert len(pair.rest.choose(pair.resting, np.array([True]), NEVER, STEP_S)) == 1
