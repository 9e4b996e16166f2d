import numpy as np
import pytest

from tests.verbs import walker
from tests.verbs.sources import arm_source, jump_source
from verbs import library
from verbs.authoring import contact_detection
from verbs.authoring.fit import build
from verbs.contacts import PARTS
from verbs.kernels import contacts as kernels

FRAME_S = 1 / 60


def built(folder, motions, **keywords):
    return build(walker.source(folder / "figure", motions, **keywords)).verb


def spans(verb, example, foot, part="ball"):
    """Intervals (R, 2) of a part of a foot by name."""
    known, joint = verb.contacts, verb.skeleton.index(foot)
    at = np.flatnonzero((known.feet == joint) & (known.parts == PARTS.index(part)))
    return known.of(verb.examples.index(example), int(at[0]))


def points(verb):
    known, names = verb.contacts, verb.skeleton.names
    return [(names[foot], PARTS[part]) for foot, part in zip(known.feet, known.parts, strict=True)]


WALKS = {"slow": (1.0, 1.0, 0.6, 120.0), "middle": (1.2, 1.0, 0.6, 60.0), "fast": (1.4, 0.9, 0.5, 30.0)}


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    motions = {name: walker.walk(*figures) for name, figures in WALKS.items()}
    return built(tmp_path_factory.mktemp("walk"), motions, looping=True)


def test_feet_have_a_heel_a_ball_and_a_toe(walk):
    assert points(walk) == [(f"{side}Foot", part) for side in ("Left", "Right") for part in ("heel", "ball", "toe")]
    heel, _, toe = walk.contacts.offsets[:3]
    np.testing.assert_allclose(heel, [0, -walker.ANKLE, -contact_detection.HEEL_SHARE * 0.13], atol=1e-4)
    np.testing.assert_allclose(toe, [0, 0, 0.07], atol=1e-9)


@pytest.mark.parametrize("name", list(WALKS))
@pytest.mark.parametrize("part", ["heel", "ball", "toe"])
def test_stances_of_a_walk_are_found_within_two_frames(walk, name, part):
    _, cycle_s, stance, fps = WALKS[name]
    for foot, begin in (("LeftFoot", 0.0), ("RightFoot", 0.5)):
        ((first, last),) = spans(walk, name, foot, part)
        gaps = np.abs([first - begin, last - begin - stance]) * cycle_s
        assert gaps.max() <= 2 * max(FRAME_S, 1 / fps)


def test_an_interval_of_a_loop_may_end_in_the_next_cycle(walk):
    assert spans(walk, "middle", "RightFoot")[0, 1] > 1.0
    right = walk.contacts.values[:, 1, 4]
    assert right[0] == right[-1] == 1.0


def test_a_run_with_flight_stands_once_a_cycle(tmp_path):
    motions = {f"run{k}": walker.walk(2.0 + 0.3 * k, 0.7 - 0.1 * k, 0.35, 60.0) for k in range(2)}
    verb = built(tmp_path, motions, looping=True)
    for name in verb.examples:
        for foot in ("LeftFoot", "RightFoot"):
            ((begin, end),) = spans(verb, name, foot)
            assert 0.25 < end - begin < 0.4
    middle = verb.contacts.values[round(0.43 * verb.intervals)]
    assert not middle.any(), "both feet are in the air"


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_a_jump_has_no_contact_in_flight(tmp_path, fps):
    flights = {"near": (1.0, 1.5), "far": (1.2, 1.8)}
    verb = built(tmp_path, {name: walker.jump(flight, fps=fps) for name, flight in flights.items()})
    for name, (off, on) in flights.items():
        found = spans(verb, name, "LeftFoot", "toe") * 2.5
        assert found[0, 0] == 0.0
        assert found[1, 1] == 2.5
        np.testing.assert_allclose(found[[0, 1], [1, 0]], [off, on], atol=0.04)


@pytest.mark.parametrize(("fps", "noise_m"), [(30.0, 0.0005), (60.0, 0.0005), (120.0, 0.0005), (60.0, 0.0)])
def test_a_figure_that_stands_has_one_contact_also_with_noise(tmp_path, fps, noise_m):
    verb = built(tmp_path, {"one": walker.stand(fps=fps, noise_m=noise_m), "other": walker.stand(3.0, noise_m=noise_m)})
    known = verb.contacts
    np.testing.assert_array_equal(known.intervals, np.tile([0.0, 1.0], (12, 1)))
    assert (known.values == 1.0).all()
    np.testing.assert_allclose(known.heights, 0.0, atol=2e-3)


@pytest.mark.parametrize(("slide_m_s", "stands"), [(0.1, True), (0.6, False)])
def test_a_foot_that_slides_fast_does_not_stand(tmp_path, slide_m_s, stands):
    """The root moves as fast, so its share of the limit does not suffice."""
    verb = built(tmp_path, {"still": walker.stand(), "slides": walker.stand(slide_m_s=slide_m_s)})
    assert len(spans(verb, "slides", "LeftFoot")) == stands


def test_each_example_has_its_own_ground(tmp_path):
    verb = built(tmp_path, {name: walker.stand(floor=floor) for name, floor in (("low", 0.0), ("high", 0.3))})
    np.testing.assert_allclose(verb.contacts.heights, [[0.0] * 6, [0.3] * 6], atol=1e-4)
    assert (verb.contacts.values == 1.0).all()


def test_standing_needs_a_sure_frame_and_then_continues():
    speeds, heights, still = np.full(60, 0.2), np.zeros(60), np.zeros(60)
    assert not contact_detection.standing(speeds, heights, still).any()
    speeds[20:30] = 0.0
    assert contact_detection.standing(speeds, heights, still).all()
    speeds[40:] = 0.3
    np.testing.assert_array_equal(contact_detection.runs(contact_detection.standing(speeds, heights, still)), [[0, 40]])
    assert contact_detection.standing(speeds, heights, np.full(60, 2.0)).all(), "limits grow with the speed of the root"


def test_height_has_two_limits_too():
    heights, still = np.full(60, 0.03), np.zeros(60)
    assert not contact_detection.standing(still, heights, still).any()
    heights[:10] = 0.02
    heights[50:] = 0.05
    np.testing.assert_array_equal(contact_detection.runs(contact_detection.standing(still, heights, still)), [[0, 50]])
    assert contact_detection.standing(still, heights, still, scale=2.0).all(), "limits grow with the leg"


@pytest.mark.parametrize(("frames", "kept"), [(4, False), (5, True)])
def test_short_contacts_are_dropped(frames, kept):
    flags = np.zeros(60, bool)
    flags[20 : 20 + frames] = True
    assert contact_detection._tidied(flags).any() == kept


@pytest.mark.parametrize(("frames", "closed"), [(3, True), (4, False)])
def test_short_gaps_are_closed_but_not_at_the_ends(frames, closed):
    flags = np.ones(60, bool)
    flags[20 : 20 + frames] = False
    assert contact_detection._tidied(flags).all() == closed
    ends = np.ones(60, bool)
    ends[:2] = ends[-2:] = False
    np.testing.assert_array_equal(contact_detection._tidied(ends), ends)


def test_values_are_one_inside_zero_outside_and_half_at_the_ends():
    times = np.linspace(0.0, 2.0, 2001)
    values = contact_detection.ramps(times, np.array([[0.5, 0.9], [1.4, 2.0]]), 2.0, looping=False)
    at = dict(zip(np.round(times, 3).tolist(), values.tolist(), strict=True))
    assert [at[t] for t in (0.5, 0.9, 1.4)] == pytest.approx([0.5] * 3, abs=1e-6)
    assert [at[t] for t in (0.0, 0.45, 0.55, 0.85, 0.95, 1.35, 1.45, 2.0)] == [0, 0, 1, 1, 0, 0, 1, 1]
    assert np.abs(np.diff(values)).max() < 0.03, "smooth"


def test_values_of_a_loop_wrap():
    times = np.linspace(0.0, 1.0, 101)
    values = contact_detection.ramps(times, np.array([[0.8, 1.2]]), 1.0, looping=True)
    assert values[0] == values[-1] == values[90] == values[10] == 1.0
    assert values[20] == pytest.approx(0.5)
    assert values[50] == 0.0
    assert (contact_detection.ramps(times, np.array([[0.0, 1.0]]), 1.0, looping=True) == 1.0).all()


def test_a_contact_that_touches_the_seam_has_ramps_on_both_sides():
    times = np.linspace(0.0, 1.0, 101)
    values = contact_detection.ramps(times, np.array([[0.0, 0.5]]), 1.0, looping=True)
    assert values[0] == values[-1] == pytest.approx(0.5)


def test_building_twice_gives_the_same_contacts(walk, tmp_path):
    again = built(tmp_path, {name: walker.walk(*figures) for name, figures in WALKS.items()}, looping=True)
    for key in ("offsets", "heights", "values", "intervals", "owners"):
        np.testing.assert_array_equal(getattr(walk.contacts, key), getattr(again.contacts, key))


def test_long_examples_are_thinned_to_find_the_feet_only(walk, monkeypatch):
    monkeypatch.setattr(contact_detection, "MOST_NUMBERS", 3000)
    thinned = contact_detection.find(walk)
    np.testing.assert_allclose(thinned.heights, walk.contacts.heights, atol=1e-4)
    np.testing.assert_allclose(thinned.offsets, walk.contacts.offsets, atol=1e-3)
    np.testing.assert_allclose(thinned.intervals, walk.contacts.intervals, atol=0.02)


def test_verbs_without_feet_have_no_contacts(tmp_path):
    assert build(arm_source(tmp_path / "arm")).verb.contacts is None
    assert build(jump_source(tmp_path / "jump")).verb.contacts is None
    assert library.load("arm3").contacts is None


def test_captured_gaits_stand_twice_in_two_strides(mocap, verb_of):
    """Each file holds two strides; the ball and the toe of each foot stand once in each of them, in runs as well."""
    verb = verb_of("locomotion")
    for i, name in enumerate(verb.examples):
        counts = [len(verb.contacts.of(i, p)) for p, part in enumerate(verb.contacts.parts) if PARTS[part] != "heel"]
        if not name.startswith("Turn"):  # the foot on which a turn pivots leaves the ground for a moment
            assert counts == ([1] * 4 if name == "Idle" else [2] * 4), name
    stands = verb.contacts.values[:-1, :, verb.contacts.feet == verb.contacts.feet[0]].max(axis=2).mean(axis=0)
    shares = dict(zip(verb.examples, stands.tolist(), strict=True))
    assert 0.55 < shares["Walk"] < 0.7
    assert 0.28 < shares["Run"] < shares["Jog"] < 0.45


def test_captured_kicks_stand_on_the_left_foot_only_at_the_apex(mocap, verb_of):
    verb = verb_of("kick")
    at = round(float(verb.phases[verb.measure.keytime]) * verb.intervals)
    left, right = (verb.contacts.feet == verb.skeleton.index(name) for name in ("LeftFoot", "RightFoot"))
    assert not verb.contacts.values[at][:, right].any()
    assert (verb.contacts.values[at][:, left].max(axis=1) == 1.0).all()
    assert (verb.contacts.values[0].max(axis=1) == 1.0).all()


def test_captured_jumps_have_no_contact_at_the_apex(mocap, verb_of):
    verb = verb_of("jump")
    at = round(float(verb.phases[verb.measure.keytime]) * verb.intervals)
    assert not verb.contacts.values[at].any()
    assert (verb.contacts.values[[0, -1]] == 1.0).all()


def test_mirrored_captures_have_mirrored_contacts(mocap, verb_of):
    verb = verb_of("jump")
    left, right = (verb.examples.index(f"Jump{side}90LowMid") for side in ("Left", "Right"))
    for p in range(3):
        np.testing.assert_allclose(verb.contacts.of(left, p), verb.contacts.of(right, p + 3), atol=0.01)


def test_contact_of_a_blend_lies_between_those_of_its_examples(walk):
    weights, out = np.array([[0.5, 0.5, 0.0]] * 50), np.empty((50, 6))
    phases = np.linspace(0, 0.999, 50)
    kernels.contact(weights, phases, walk.contacts.values, True, out)
    both = []
    for i in range(2):
        own = np.empty((50, 6))
        kernels.contact(np.tile(np.eye(3)[i], (50, 1)), phases, walk.contacts.values, True, own)
        both.append(own)
    np.testing.assert_allclose(out, 0.5 * (both[0] + both[1]), atol=1e-6)
