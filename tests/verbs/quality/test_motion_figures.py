import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs import walker
from verbs import library
from verbs.authoring.fit import build
from verbs.cli import app
from verbs.kernels import capsules, quat
from verbs.quality import motion
from verbs.quality.balance import Balance, outside
from verbs.quality.humanoid import Humanoid
from verbs.quality.joint_ranges import Ranges
from verbs.quality.samples import sample
from verbs.quality.self_intersection import SHARES, Capsules
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.whole_motion import examples
from verbs.skeleton import Skeleton


def built(folder, motions, **keywords):
    return build(walker.source(folder / "figure", motions, **keywords)).verb


@pytest.fixture(scope="module")
def reach():
    return library.load("reach")


@pytest.fixture(scope="module")
def compared(reach):
    return motion.compare(reach, goals=6)


def test_a_foot_that_slides_at_a_known_speed_has_that_speed_and_skates_above_the_limit(tmp_path):
    slow = built(tmp_path / "a", {"a": walker.stand(slide_m_s=0.1), "b": walker.stand(slide_m_s=0.1)})
    found = motion.compare(slow, goals=2).examples.values
    assert found["toe_speed_mean_m_s"] == pytest.approx(0.1, abs=0.003)
    assert found["skate_ratio"] == 0.0
    assert found["slide_max_m"] == pytest.approx(0.1, abs=0.003), "0.1 m/s for 2 s, from the middle"
    one = sample(Evaluator(slow), examples(Evaluator(slow))[0])
    known = slow.contacts
    faster = replace(one, positions=one.positions * np.array([1.0, 1.0, 3.0]))
    toes = np.flatnonzero(known.parts == 1)
    speeds, low = motion._toes(faster, known, toes, known.heights[0])
    assert low.all()
    np.testing.assert_allclose(speeds, 0.3, atol=0.01)


def test_toes_above_five_centimetres_do_not_count(tmp_path):
    verb = built(tmp_path, {"jump": walker.jump(), "still": walker.stand(2.5)})
    one = sample(Evaluator(verb), examples(Evaluator(verb))[0])
    low = motion._toes(one, verb.contacts, np.flatnonzero(verb.contacts.parts == 1), verb.contacts.heights[0])[1]
    flight = np.mean(~low.all(axis=1)) * len(low) / 60.0
    assert 0.35 < flight < 0.5, "0.5 s of flight, 30 cm high, of which the ends are low"


def test_known_accelerations_are_measured():
    at = np.arange(61) / 60.0
    positions = np.zeros((61, 1, 3))
    positions[:, 0, 1] = 2.0 * at**2
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (61, 1, 1))
    rotations = quat.exp(np.stack([1.5 * at**2, 0 * at, 0 * at], axis=-1))[:, None]
    one = sample_of(positions, rotations, turned)
    np.testing.assert_allclose(one.accelerations, 4.0, rtol=1e-9)
    np.testing.assert_allclose(motion._angular_accelerations(one, np.array([0])), 3.0, rtol=1e-6)


def sample_of(positions, rotations, turned):
    from verbs.quality.samples import Sample

    return Sample(np.ones(1), np.linspace(0, 1, 61), rotations, turned, positions, np.ones(61, bool))


def test_a_joint_that_leaves_the_range_of_the_examples_by_a_known_angle():
    angles = np.linspace(-0.4, 0.6, 61)
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (61, 2, 1))
    rotations[:, 1] = quat.exp(np.stack([angles, 0 * angles, 0 * angles], axis=-1))
    one = sample_of(np.zeros((61, 2, 3)), rotations, rotations)
    ranges = Ranges.of_samples(np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)), [one])
    assert ranges.excess(rotations).max() < 1e-12
    beyond = np.tile([0.0, 0.0, 0.0, 1.0], (1, 2, 1))
    beyond[0, 1] = quat.exp(np.array([0.9, 0.0, 0.0]))
    assert ranges.excess(beyond)[0, 1] == pytest.approx(0.3, abs=1e-9)
    beyond[0, 0] = quat.exp(np.array([3.0, 0.0, 0.0]))
    assert ranges.excess(beyond)[0, 0] == 0.0, "the root has no range"
    still = np.tile([0.0, 0.0, 0.0, 1.0], (61, 2, 1))
    rigid = Ranges.of_samples(np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)), [sample_of(np.zeros((61, 2, 3)), still, still)])
    assert rigid.excess(beyond)[0, 1] == 0.0, "no example moves this joint"


def test_distances_of_segments_agree_with_a_fine_grid():
    rng = np.random.default_rng(0)
    shares = np.linspace(0, 1, 201)
    for _ in range(40):
        p1, q1, p2, q2 = rng.normal(size=(4, 3))
        one = p1 + shares[:, None] * (q1 - p1)
        other = p2 + shares[:, None] * (q2 - p2)
        nearest = np.linalg.norm(one[:, None] - other[None], axis=-1).min()
        assert nearest - 0.01 < capsules.segment_distance(p1, q1, p2, q2) < nearest + 1e-12
    corner, ways = np.zeros(3), np.eye(3)
    assert capsules.segment_distance(corner, corner, ways[0], ways[0]) == 1.0
    assert capsules.segment_distance(corner, ways[0], ways[1], ways[1] + ways[0]) == pytest.approx(1.0)


def test_a_hand_in_the_trunk_is_found_with_its_depth():
    skeleton = library.load("reach").skeleton
    capsules_of = Capsules.of_skeleton(skeleton)
    pairs = {frozenset((capsules_of.names[a], capsules_of.names[b])) for a, b in capsules_of.pairs}
    assert frozenset(("right hand", "trunk")) in pairs
    assert frozenset(("left thigh", "right thigh")) in pairs
    for met in (("right upper arm", "right forearm"), ("trunk", "left thigh"), ("trunk", "right upper arm")):
        assert frozenset(met) not in pairs
    rest = np.tile([0.0, 0.0, 0.0, 1.0], (61, len(skeleton), 1))
    places = np.zeros((61, len(skeleton), 3))
    for joint in range(1, len(skeleton)):
        places[:, joint] = places[:, skeleton.parents[joint]] + skeleton.offsets[joint]
    apart = sample_of(places, rest, rest)
    before = capsules_of.depths(apart)
    moved = places.copy()
    hand, spine = skeleton.index("RightHand"), skeleton.index("Spine1")
    moved[:, hand] = moved[:, spine]
    found = capsules_of.depths(sample_of(moved, rest, rest))
    names = list(capsules_of.names)
    radii = capsules_of.radii[names.index("right hand")] + capsules_of.radii[names.index("trunk")]
    assert found.max() >= radii - 1e-9
    assert found.max() > before.max()


def test_a_skeleton_without_standard_names_has_a_capsule_for_each_long_bone():
    chain = Skeleton(("a", "b", "c", "d", "e"), np.array([-1, 0, 1, 2, 3]), np.array(
        [[0, 0, 0], [0, 1, 0], [0, 1, 0], [0.01, 0, 0], [0, 1, 0]], float))  # fmt: skip
    found = Capsules.of_skeleton(chain)
    assert found.names == ("b", "c", "e")
    assert found.pairs.tolist() == [[0, 2]], "c and e meet at the short bone d"
    np.testing.assert_allclose(found.radii, 0.12)
    assert Capsules.of_skeleton(Skeleton(("a", "b"), np.array([-1, 0]), np.array([[0, 0, 0], [0, 1.0, 0]]))) is None


def test_distance_outside_a_polygon():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]])
    assert outside(np.array([0.3, 0.7]), square) == 0.0
    assert outside(np.array([1.5, 0.5]), square) == pytest.approx(0.5)
    assert outside(np.array([2.0, 2.0]), square) == pytest.approx(np.sqrt(2))
    assert outside(np.array([0.5, 0.3]), square[:2]) == pytest.approx(0.3), "one foot is a line"
    assert outside(np.array([3.0, 4.0]), square[:1]) == pytest.approx(5.0)


def test_the_centre_of_mass_lies_between_the_hips_and_the_neck_and_follows_the_body(reach):
    human = Humanoid.of_skeleton(reach.skeleton)
    balance = Balance.of_humanoid(human)
    assert balance.masses.sum() == pytest.approx(1.0)
    one = sample(Evaluator(reach), examples(Evaluator(reach))[0])
    centre, step = balance.centre(one.positions), np.array([0.1, 0.0, 0.0])
    hips, neck = (one.positions[:, human.joints[name], 1] for name in ("hips", "neck"))
    assert (centre[:, 1] > hips - 0.1).all()
    assert (centre[:, 1] < neck).all()
    np.testing.assert_allclose(balance.centre(one.positions + step) - centre, np.tile(step, (len(centre), 1)))


def test_a_body_that_leans_off_its_feet_is_off_balance_by_that_much(reach):
    evaluator, known = Evaluator(reach), reach.contacts
    balance = Balance.of_humanoid(Humanoid.of_skeleton(reach.skeleton))
    one = sample(evaluator, examples(evaluator)[0])
    standing = np.ones((len(one.phases), len(known)))
    assert balance.distances(one, known, standing).max() == 0.0
    pushed = one.positions.copy()
    legs = [
        joint for name, joint in Humanoid.of_skeleton(reach.skeleton).joints.items() if "foot" in name or "toe" in name
    ]
    upper = [joint for joint in range(len(reach.skeleton)) if joint not in legs]
    pushed[:, upper] += [0.0, 0.0, 1.0]
    far = balance.distances(replace(one, positions=pushed), known, standing)
    assert 0.6 < far.min() < 1.0


def test_standard_names_may_have_a_prefix_and_none_may_be_missing(reach):
    skeleton = reach.skeleton
    prefixed = replace(skeleton, names=tuple(f"mixamorig:{name}" for name in skeleton.names))
    assert Humanoid.of_skeleton(prefixed).joints == Humanoid.of_skeleton(skeleton).joints
    other = replace(skeleton, names=tuple(name.replace("Neck", "Cervix") for name in skeleton.names))
    assert Humanoid.of_skeleton(other) is None


def test_every_figure_has_a_value_or_a_reason(reach, compared):
    verbs = [compared, motion.compare(library.load("arm3"), goals=2)]
    for one in verbs:
        for side in filter(None, (one.examples, one.blends, one.planted)):
            assert set(side.values) == {figure.key for figure in motion.FIGURES}
            for key, value in side.values.items():
                assert (value is None) == (key in side.reasons)
                assert value is None or np.isfinite(value)
    assert verbs[0].blends.values["seam_position_m"] is None
    assert verbs[1].blends.reasons["slide_max_m"] == "the skeleton has no feet"
    assert "standard joint names" in verbs[1].blends.reasons["balance_max_m"]


def test_examples_stay_in_their_own_range_and_blends_slide_more(compared):
    own, blends = compared.examples.values, compared.blends.values
    assert own["range_max_rad"] == 0.0
    assert blends["range_max_rad"] > 0.0
    assert own["slide_max_m"] < 1e-4 < blends["slide_max_m"]
    assert blends["slide_median_m"] <= blends["slide_p90_m"] <= blends["slide_max_m"]


def test_planted_feet_do_not_slide_and_the_verb_without_feet_has_no_such_figures(compared):
    assert compared.planted.values["slide_max_m"] < 0.2 * compared.blends.values["slide_max_m"]
    assert compared.planted.values["penetration_m"] < 0.5 * compared.blends.values["penetration_m"]
    assert compared.planted.values["effector_speed_median_m_s"] > 0.0
    assert motion.compare(library.load("arm3"), goals=2).planted is None


def test_the_seam_of_a_loop_is_closed_and_an_open_one_is_measured(tmp_path):
    verb = built(tmp_path, {"slow": walker.walk(1.0), "fast": walker.walk(1.2)}, looping=True)
    found = motion.compare(verb, goals=2)
    assert found.blends.values["seam_position_m"] < 1e-6
    assert found.blends.values["seam_velocity_m_s"] < 0.02
    curves = np.array(verb.curves)
    curves[: len(curves) // 2, :, 1] += np.float32(0.05)
    torn = motion.compare(replace(verb, curves=curves), goals=2)
    assert torn.blends.values["seam_position_m"] == pytest.approx(0.05, abs=1e-3)


def test_goals_are_the_same_every_time(reach, compared):
    again = motion.compare(reach, goals=6)
    assert again.as_dict() == compared.as_dict()


def test_the_command_prints_the_figures(compared):
    arguments = ["measure", "reach", "--motion", "--goals", "6"]
    shown = CliRunner().invoke(app, arguments)
    assert shown.exit_code == 0
    assert "skate ratio" in shown.stdout
    assert "does not loop" in shown.stdout
    answer = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    assert answer == json.loads(json.dumps(compared.as_dict()))
    rbf = json.loads(CliRunner().invoke(app, [*arguments, "--json", "--method", "rbf"]).stdout)
    assert rbf["method"] == "rbf"
    assert rbf["blends"] != answer["blends"]
    assert CliRunner().invoke(app, [*arguments, "--method", "magic"]).exit_code != 0


def test_radii_are_shares_of_bones(reach):
    found = Capsules.of_skeleton(reach.skeleton)
    thigh = np.linalg.norm(reach.skeleton.offsets[reach.skeleton.index("LeftLeg")])
    assert found.radii[found.names.index("left thigh")] == pytest.approx(SHARES["thigh"] * thigh)


@pytest.mark.parametrize("name", ["kick", "punch"])
def test_captured_examples_are_in_range_and_hardly_enter_themselves(mocap, verb_of, name):
    found = motion.compare(verb_of(name), goals=10)
    own = found.examples.values
    assert own["range_max_rad"] == 0.0
    assert own["intersecting_ratio"] < 0.01
    assert own["skate_ratio"] < 0.1
    assert 100 < own["acceleration_median_m_s2"] < 160
    assert found.blends.values["skate_ratio"] > own["skate_ratio"]
