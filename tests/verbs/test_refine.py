from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import cache

import numpy as np
import pytest

from verbs import library
from verbs.blend.cardinal import basis_weights
from verbs.blend.refined import Hybrid, Refined
from verbs.domain import accuracy_points, random_points
from verbs.errors import OutOfRange, RequestError, UnknownName
from verbs.goal import Goal, diagonal
from verbs.io import artifact
from verbs.kernels import measure as measures
from verbs.kernels import radial_basis
from verbs.refine import Mark, Rules, Step, refine, resume, with_basis
from verbs.verb import Basis, Verb

FOREVER = Rules(target_error=0.0, patience=0)


@cache
def steps(name: str, count: int, **changes) -> tuple[Step, ...]:
    return tuple(refine(library.load(name), replace(FOREVER, max_pseudo=count, **changes)))


@cache
def load(name: str) -> Verb:
    return library.load(name)


def percent(verb: Verb, weights, adverbs) -> tuple[float, float]:
    """Mean and largest error, % of the diagonal."""
    goal = Goal.of_verb(verb)
    error = 100 * goal.compare(adverbs, goal.measured(weights))[1] / diagonal(verb)
    return error.mean(), error.max()


def same(first: Basis, second: Basis) -> bool:
    return all(
        np.array_equal(getattr(first, key), getattr(second, key)) for key in ("centers", "radii", "radial", "poly")
    )


def system(basis: Basis):
    return radial_basis.radial_matrix(basis.radial_basis, basis.centers, basis.centers, basis.radii)


# methods.md §1.1, table A9: average and maximum over the 41×41 grid, in % of the diagonal
@pytest.mark.parametrize(
    ("count", "mean", "largest"),
    [(0, 4.37, 12.25), (5, 1.64, 4.82), (10, 0.985, 2.49), (20, 0.61, 1.65), (50, 0.209, 0.584), (100, 0.077, 0.255)],
)
def test_planar_arm_repeats_the_study(count, mean, largest):
    found = steps("arm3", 100)[count]
    assert found.pseudo == count
    assert 100 * found.after.mean == pytest.approx(mean, rel=0.01)
    assert 100 * found.after.largest == pytest.approx(largest, rel=0.01)


def test_planar_arm_meets_its_targets_off_the_search_points_too():
    verb = load("arm3")
    points = random_points(verb, np.random.default_rng(99), 2_500)
    for count, mean in ((20, 0.65), (100, 0.09)):
        assert percent(verb, basis_weights(steps("arm3", 100)[count].basis, points), points)[0] <= mean


def test_planar_hybrid_is_ten_times_better_than_pseudo_examples_alone():
    verb, basis = load("arm3"), steps("arm3", 100)[20].basis
    points = accuracy_points(verb).adverbs
    hybrid = Hybrid.of_verb(replace(verb, bases={**verb.bases, "refined": basis}))
    assert percent(verb, hybrid.weights(points), points)[0] <= 0.06  # 0.61 without the search


def test_reach_beats_the_paper_with_120_pseudo_examples():
    verb, basis = load("reach"), steps("reach", 120)[-1].basis
    points = accuracy_points(verb).adverbs  # another seed than the search points'
    mean, largest = percent(verb, basis_weights(basis, points), points)
    assert (mean <= 0.51, largest <= 1.41) == (True, True)
    hybrid = Hybrid.of_verb(replace(verb, bases={**verb.bases, "refined": basis}))
    mean, largest = percent(verb, hybrid.weights(points[:500]), points[:500])
    assert (mean <= 0.053, largest <= 0.96) == (True, True)


def test_radii_that_follow_their_neighbours_stall():
    local, follow = steps("arm3", 100), steps("arm3", 50, radii="global", planes="refit")
    assert follow[50].after.mean > 3 * local[50].after.mean
    assert follow[50].after.largest > 4 * local[50].after.largest
    assert follow[50].after.mean / follow[25].after.mean > 1.4 * local[50].after.mean / local[25].after.mean


def test_refitting_planes_alone_changes_little():
    kept, refit = steps("arm3", 100)[50], steps("arm3", 50, planes="refit")[50]
    assert refit.after.mean == pytest.approx(kept.after.mean, rel=0.25)
    assert not np.array_equal(refit.basis.poly, kept.basis.poly)


def test_places_alone_get_stuck_where_the_map_folds():
    places = steps("reach", 40, search="adverbs")[-1]
    assert places.mark.stopped == "no usable point left"
    assert places.after.largest > 1.5 * steps("reach", 120)[places.pseudo].after.largest


def test_corrected_weights_are_as_good_as_places():
    assert steps("arm3", 50, search="weights")[-1].after.mean == pytest.approx(
        steps("arm3", 100)[50].after.mean, rel=0.1
    )


@pytest.mark.parametrize("name", ["arm3", "reach"])
@pytest.mark.parametrize("changes", [{}, {"radii": "global", "planes": "refit"}])
def test_weights_are_exact_at_all_centers(name, changes):
    verb, taken = load(name), steps(name, {"arm3": 50, "reach": 15}[name], **changes)
    basis, goal, count = taken[-1].basis, Goal.of_verb(verb), len(verb.values)
    assert np.allclose(basis_weights(basis, verb.values), np.eye(count), atol=1e-12)
    drawn = [step.drawn for step in taken[1:]]
    places = np.array([one.adverbs for one in drawn])
    weights = basis_weights(basis, places)
    assert np.allclose(weights, [one.weights for one in drawn], atol=1e-11)
    assert np.allclose(weights.sum(axis=1), 1.0, atol=1e-11)
    assert goal.compare(places, goal.measured(weights))[1].max() / diagonal(verb) <= 1.1e-6


def test_pseudo_example_is_the_blend_at_its_source():
    drawn, before = steps("arm3", 100)[1].drawn, steps("arm3", 100)[0].basis
    assert np.allclose(basis_weights(before, drawn.source[None])[0], drawn.weights, atol=1e-12)


def test_first_pseudo_example_is_at_the_worst_point():
    verb, first = load("arm3"), steps("arm3", 100)[1]
    points = accuracy_points(verb).adverbs
    goal = Goal.of_verb(verb)
    error = goal.compare(points, goal.measured(basis_weights(verb.bases["rbf"], points)))[1]
    assert np.array_equal(first.drawn.adverbs, points[np.argmax(error)])
    assert first.before.largest == pytest.approx(error.max() / diagonal(verb), rel=1e-12)


def test_old_radii_and_planes_stay_and_a_new_radius_is_the_nearest_distance():
    start, end = load("arm3").bases["rbf"], steps("arm3", 100)[-1].basis
    assert np.array_equal(end.radii[:9], start.radii)
    assert np.array_equal(end.poly, start.poly)
    for k in range(9, len(end.centers)):
        assert end.radii[k] == pytest.approx(np.linalg.norm(end.centers[:k] - end.centers[k], axis=1).min())


def test_system_stays_well_conditioned_without_a_floor_of_radii():
    for name, count in (("arm3", 100), ("reach", 120)):
        basis = steps(name, count)[-1].basis
        assert np.linalg.cond(system(basis)) < 200
        assert basis.condition == pytest.approx(np.linalg.cond(system(basis), 1), rel=0.5)


def test_refinement_is_the_same_each_time():
    again = list(refine(load("reach"), replace(FOREVER, max_pseudo=10)))
    assert all(same(a.basis, b.basis) for a, b in zip(again, steps("reach", 120), strict=False))


def test_another_seed_searches_elsewhere():
    other = list(refine(load("reach"), replace(FOREVER, max_pseudo=2, seed=2)))[-1]
    assert not np.array_equal(other.basis.centers, steps("reach", 120)[2].basis.centers)


@pytest.mark.parametrize(("name", "changes"), [("arm3", {}), ("reach", {}), ("arm3", {"radii": "global"})])
def test_going_on_from_any_step_gives_the_same_bases(name, changes, tmp_path):
    whole, rules = steps(name, 12, **changes), replace(FOREVER, max_pseudo=12, **changes)
    for step in whole[:-1:3]:
        mark = Mark(**json.loads(json.dumps(asdict(step.mark))))
        artifact.save(with_basis(load(name), step.basis, rules, mark), tmp_path / "kept.verb")
        kept = artifact.load(tmp_path / "kept.verb")
        rest = list(resume(kept, kept.bases["refined"], mark, rules))
        assert [one.mark for one in rest] == [one.mark for one in whole[step.mark.number + 1 :]]
        assert all(same(a.basis, b.basis) for a, b in zip(rest, whole[step.mark.number + 1 :], strict=True))


def test_nothing_follows_the_last_step():
    last = steps("arm3", 5)[-1]
    assert list(resume(load("arm3"), last.basis, last.mark, replace(FOREVER, max_pseudo=5))) == []


def test_it_says_why_it_stops():
    verb = load("arm3")

    def end(**rules) -> Step:
        return list(refine(verb, Rules(**rules)))[-1]

    assert end(target_error=0.02).mark.stopped == "target met"
    assert end(target_error=0.02).after.largest <= 0.02 < end(target_error=0.02).before.largest
    assert end(target_error=1.0).pseudo == 0
    assert (end(target_error=0.0, max_pseudo=3).mark.stopped, end(max_pseudo=3).pseudo) == (
        "most pseudo-examples reached",
        3,
    )
    stalled = end(target_error=0.0, radii="global", planes="refit", patience=6)
    assert (stalled.mark.stopped, stalled.mark.idle) == ("no progress", 6)
    centers_only = list(refine(verb, Rules(target_error=0.0), points=verb.values + 1e-5))
    assert centers_only[-1].mark.stopped == "no usable point left"


def test_no_point_is_used_twice():
    few = random_points(load("arm3"), np.random.default_rng(3), 10)
    taken = list(refine(load("arm3"), FOREVER, points=few))
    places = [step.drawn.adverbs for step in taken if step.drawn is not None]
    assert len(np.unique(places, axis=0)) == len(places) <= 10
    assert taken[-1].after.largest < 1e-6


def test_refined_verb_tells_its_error_at_unseen_points_and_how_it_was_made(tmp_path):
    verb, last = load("reach"), steps("reach", 120)[-1]
    rules = replace(FOREVER, max_pseudo=120)
    refined = with_basis(verb, last.basis, rules, last.mark)
    figures = refined.quality["methods"]["refined"]
    assert figures["error_mean_m"] == pytest.approx(last.after.mean * diagonal(verb), rel=0.15)
    assert refined.provenance["refinement"] == asdict(rules) | {"steps": 120, "pseudo_examples": 120}
    assert refined.bases["refined"].condition == pytest.approx(np.linalg.cond(system(last.basis)))
    artifact.save(refined, tmp_path / "refined.verb")
    back = artifact.load(tmp_path / "refined.verb")
    assert same(back.bases["refined"], last.basis)
    assert (back.quality, back.provenance) == (refined.quality, refined.provenance)
    points = random_points(verb, np.random.default_rng(4), 50)
    assert np.array_equal(Refined.of_verb(back).weights(points), Refined.of_verb(refined).weights(points))


@pytest.mark.parametrize("name", ["kick", "locomotion"])
def test_real_captures_are_refined(name, verb_of):
    verb = verb_of(name)
    taken = list(refine(verb, replace(FOREVER, max_pseudo=6, samples=500)))
    assert taken[-1].after.mean < 0.9 * taken[0].after.mean
    places = np.array([step.drawn.adverbs for step in taken[1:]])
    goal = Goal.of_verb(verb)
    error = goal.compare(places, goal.measured(basis_weights(taken[-1].basis, places)))[1]
    assert error.max() < 1e-5


def test_a_jump_is_exact_as_it_is(verb_of):
    (only,) = refine(verb_of("jump"), Rules(target_error=0.0))
    assert (only.mark.stopped, only.pseudo) == ("target met", 0)


def test_style_is_held_while_the_rest_is_searched():
    # the arm with a style adverb: the same examples, some "tired"
    verb = load("arm3")
    style = replace(verb.adverbs[0], name="tired", unit="", style=True, minimum=0.0, maximum=1.0)
    tired = np.linspace(0.0, 1.0, 9)[[4, 0, 7, 2, 8, 5, 1, 6, 3], None]
    values = np.concatenate([verb.values, tired], axis=1)
    from verbs.authoring import basis as bases

    chart = bases.chart_of(values, ("m", "m", ""))
    styled = replace(
        verb,
        adverbs=(*verb.adverbs, style),
        values=values,
        domain=bases.domain_of(chart, values),
        bases={"rbf": bases.cardinal(chart, values), "smooth": bases.smooth(chart, values)},
    )
    taken = list(refine(styled, replace(FOREVER, max_pseudo=15, samples=300, search="adverbs")))
    assert taken[-1].pseudo == 15
    for step in taken[1:]:
        assert step.drawn.source[2] == pytest.approx(step.drawn.adverbs[2], abs=1e-12)
    assert taken[-1].after.mean < 0.7 * taken[0].after.mean


def test_what_cannot_be_measured_is_refused():
    verb = load("arm3")
    nothing = replace(verb.measure, kind=measures.NOTHING, axes=verb.measure.axes[:0], frame=np.zeros((3, 0)))
    with pytest.raises(RequestError, match="style adverbs only"):
        next(refine(replace(verb, measure=nothing)))


def test_unbounded_radial_functions_are_refused():
    verb = load("arm3")
    with pytest.raises(RequestError, match="compact"):
        next(refine(replace(verb, bases={**verb.bases, "rbf": verb.bases["smooth"]})))


@pytest.mark.parametrize(
    ("rules", "error", "text"),
    [
        ({"radii": "round"}, UnknownName, "unknown radii 'round'; known: local, global"),
        ({"planes": "x"}, UnknownName, "known: frozen, refit"),
        ({"search": "x"}, UnknownName, "known: either, adverbs, weights"),
        ({"max_pseudo": -1}, OutOfRange, "max_pseudo is -1; it must lie between 0 and 2000"),
        ({"samples": 0}, OutOfRange, "samples is 0; it must lie between 1"),
        ({"target_error": float("nan")}, OutOfRange, "target_error is nan"),
    ],
)
def test_rules_outside_their_bounds_are_refused(rules, error, text):
    with pytest.raises(error, match=text):
        Rules(**rules)


@pytest.mark.parametrize("points", [np.zeros((0, 2)), np.zeros((5, 3)), np.full((2, 2), np.nan)])
def test_search_points_must_be_points(points):
    with pytest.raises(OutOfRange, match=r"shape \(number, 2\)"):
        next(refine(load("arm3"), points=points))


def test_places_lie_inside_the_domain():
    verb = load("reach")
    places = verb.domain.chart.points(np.array([step.drawn.adverbs for step in steps("reach", 120)[1:]]))
    assert ((places - verb.domain.middle) @ verb.domain.facets.T).max() <= 1.0 + 1e-6
