import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs import walker
from verbs import library, refine_quality
from verbs.authoring.basis import smooth
from verbs.authoring.fit import build
from verbs.blend.corrected import Corrected
from verbs.cli import app
from verbs.domain import random_points
from verbs.errors import OutOfRange, RequestError
from verbs.io import artifact
from verbs.quality.joint_ranges import Ranges
from verbs.quality.samples import sample
from verbs.refine_quality import Mark, Rules, loop
from verbs.refine_quality.cost import EXCESS, IMPOSSIBLE, PEAK, RMS, SLIP, MotionCost
from verbs.refine_quality.guards import Guards, evaluator_with, plain_basis
from verbs.refine_quality.judge import _reasons
from verbs.refine_quality.solve import better_weights
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.whole_motion import examples, one_of

RULES = Rules(max_pseudo=2, samples=30, patience=2, seed=3)


@pytest.fixture(scope="module")
def reach():
    return library.load("reach")


@pytest.fixture(scope="module")
def steps(reach):
    return list(refine_quality.refine(reach, RULES))


@pytest.fixture(scope="module")
def refined(reach, steps):
    return refine_quality.with_basis(reach, steps[-1].basis, RULES, steps[-1].mark)


@pytest.fixture(scope="module")
def goals(reach):
    return random_points(reach, np.random.default_rng(11), 40)


@pytest.fixture(scope="module")
def cost(reach, goals):
    return MotionCost.of_verb(reach, Evaluator(reach).blend(goals).weights)


def test_compiled_figures_are_those_of_sampled_motions(reach, goals, cost):
    evaluator = Evaluator(reach)
    blend = evaluator.blend(goals[:5])
    figures = cost.figures(blend.weights)
    ranges = Ranges.of_samples(reach.references, [sample(evaluator, one) for one in examples(evaluator)])
    for k in range(5):
        one = sample(evaluator, one_of(blend, k))
        assert figures[k, PEAK] == pytest.approx(one.accelerations.max(), rel=1e-6)
        assert figures[k, RMS] == pytest.approx(np.sqrt(np.mean(one.accelerations**2)), rel=0.02)
        assert figures[k, EXCESS] == pytest.approx(ranges.excess(one.rotations).max(), abs=1e-9)


def test_a_loop_is_judged_over_its_seam(tmp_path):
    verb = build(walker.source(tmp_path / "w", {"a": walker.walk(1.0), "b": walker.walk(1.2)}, looping=True)).verb
    found = MotionCost.of_verb(verb, np.eye(2)).figures(np.array([[0.5, 0.5]]))
    assert np.isfinite(found).all()
    curves = np.array(verb.curves)
    curves[: len(curves) // 2, :, 1] += np.float32(0.5)
    torn = MotionCost.of_verb(replace(verb, curves=curves), np.eye(2)).figures(np.array([[0.5, 0.5]]))
    assert torn[0, PEAK] > 2.0 * found[0, PEAK]


def test_slip_is_the_speed_of_standing_points(tmp_path):
    motions = {"a": walker.stand(slide_m_s=0.3), "b": walker.stand()}
    verb = build(walker.source(tmp_path / "s", motions, more=_STANDS)).verb
    figures = MotionCost.of_verb(verb, np.eye(2)).figures(np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]]))
    np.testing.assert_allclose(figures[:, SLIP], [0.3, 0.0, 0.15], atol=2e-3)
    bare = MotionCost.of_verb(replace(verb, contacts=None), np.eye(2)).figures(np.eye(2))
    assert not bare[:, SLIP].any()


_STANDS = "\n".join(
    f'[[contact]]\njoint = "{side}Foot"\nintervals = {{ a = [[0.0, 2.0]], b = [[0.0, 2.0]] }}'
    for side in ("Left", "Right")
)


def test_a_motion_of_impossible_length_has_the_largest_cost(reach, cost):
    far = np.zeros((2, len(reach.examples)))
    far[0, :2] = 4000.0, -3999.0
    far[1, :2] = np.nan
    assert (cost.costs(far) == IMPOSSIBLE).all()
    assert (cost.costs(np.eye(len(reach.examples))) < 10.0).all()


def test_better_weights_are_exact_hold_their_sum_and_cost_less(reach, goals, cost):
    corrected = Corrected.of_verb(reach)
    start = corrected.weights(goals)
    worst = int(np.argmax(cost.costs(start)))
    goal = corrected.goal.points(goals)[worst]
    found = better_weights(cost, corrected, start[worst], goal)
    assert found.sum() == pytest.approx(1.0, abs=1e-9)
    assert np.linalg.norm(corrected.goal.measured(found[None])[0] - goal) < 1e-3
    before, after = cost.costs(np.stack([start[worst], found]))
    assert after < 0.9 * before


def test_an_arm_in_a_plane_has_weights_to_choose_too():
    verb = library.load("arm3")
    corrected = Corrected.of_verb(verb)
    start = corrected.weights(verb.values[:1] * 0.9)
    cost = MotionCost.of_verb(verb, start)
    goal = corrected.goal.points(verb.values[:1] * 0.9)[0]
    found = better_weights(cost, corrected, start[0], goal)
    assert cost.costs(found[None])[0] <= cost.costs(start)[0]
    assert not np.array_equal(found, start[0])


def test_the_cost_falls_and_every_kept_step_gains(steps):
    assert steps[0].mark.number == 0
    assert steps[-1].pseudo >= 1
    assert steps[-1].mark.stopped
    for step in steps[1:]:
        if step.problem:
            assert step.after == step.before
        else:
            assert step.after.mean <= 0.995 * step.before.mean
    assert [step.mark.number for step in steps] == list(range(len(steps)))
    assert len(set(steps[-1].mark.tried)) == len(steps) - 1


def test_a_refined_verb_is_exact_and_cardinal(reach, refined, goals):
    assert len(refined.bases["smooth"].centers) > len(reach.examples)
    evaluator = Evaluator(refined)
    blend = evaluator.blend(goals)
    assert blend.method == "corrected"
    assert blend.error.max() < 1e-9
    single = np.concatenate([evaluator.blend(row[None]).weights for row in goals[:4]])
    np.testing.assert_allclose(single, blend.weights[:4], atol=1e-9)
    at_examples = evaluator.blend(reach.values).weights
    np.testing.assert_allclose(at_examples, np.eye(len(reach.examples)), atol=1e-8)
    moved = np.abs(blend.weights - Evaluator(reach).blend(goals).weights).max()
    assert moved > 1e-3, "the answers differ from those before"


def test_an_interrupted_refinement_goes_on_as_if_it_had_not_been(reach, steps):
    basis, mark = reach.bases["smooth"], refine_quality.START
    for step in steps:
        again = next(refine_quality.resume(reach, basis, mark, RULES))
        basis, mark = again.basis, again.mark
        assert mark == step.mark
        np.testing.assert_array_equal(basis.radial, step.basis.radial)


def test_the_same_seed_gives_the_same_basis_and_another_seed_another(reach, steps):
    first = next(iter(refine_quality.refine(reach, RULES)))
    assert first.after == steps[0].after
    other = next(iter(refine_quality.refine(reach, replace(RULES, seed=4))))
    assert other.after != first.after


def test_a_refined_verb_is_stored_and_read_again(refined, goals, tmp_path):
    artifact.save(refined, tmp_path / "r.verb")
    read = artifact.load(tmp_path / "r.verb")
    np.testing.assert_array_equal(Evaluator(read).blend(goals).weights, Evaluator(refined).blend(goals).weights)
    made = read.provenance["quality_refinement"]
    assert made["pseudo_examples"] == len(read.bases["smooth"].centers) - len(read.examples)
    assert read.quality["methods"]["corrected"]["error_max_m"] < 1e-9


def test_a_refined_verb_can_be_refined_again_against_its_plain_basis(reach, refined):
    plain = plain_basis(refined)
    np.testing.assert_allclose(plain.radial, smooth(plain.chart, reach.values).radial, atol=1e-9)
    first = next(iter(refine_quality.refine(refined, RULES)))
    assert first.pseudo == len(refined.bases["smooth"].centers) - len(reach.examples)
    assert first.mark.stopped == ("most pseudo-examples reached" if first.pseudo == 2 else "")


def test_failures_in_a_row_end_a_refinement(reach, monkeypatch):
    monkeypatch.setattr(loop._Ground, "accepted", lambda self, basis, before: (None, "refused"))
    steps = list(refine_quality.refine(reach, RULES))
    assert [step.mark.failed for step in steps] == [0, 1, 2]
    assert steps[-1].mark.stopped == "2 attempts without a gain"
    assert steps[-1].problem == "refused"
    assert steps[-1].pseudo == 0


def test_goals_near_centers_are_left_out(reach):
    ground = loop._Ground.of_verb(reach, RULES)
    costs = np.arange(30.0)
    chosen = ground.costliest(ground.corrected.basis, costs, Mark(0))
    gaps = np.linalg.norm(ground.points[:, None] - ground.corrected.basis.centers[None], axis=-1).min(axis=1)
    assert chosen == np.flatnonzero(gaps >= ground.spacing).max()
    centers = np.concatenate([ground.corrected.basis.centers[:-1], ground.points[chosen : chosen + 1]])
    crowded = replace(ground.corrected.basis, centers=centers)
    assert ground.costliest(crowded, costs, Mark(0)) != chosen
    assert ground.costliest(crowded, costs, Mark(0, tuple(range(30)))) is None


def test_guards_name_what_is_exceeded(reach):
    plain = Guards.of_evaluator(evaluator_with(reach, reach.bases["smooth"]), 1, reach.values)
    assert plain.error_max < 1e-9
    assert plain.exceeded(plain) == ""
    assert replace(plain, error_max=1e-6).exceeded(plain) == "error"
    assert replace(plain, weight_sum_max=1.3 * plain.weight_sum_max).exceeded(plain) == "sum of absolute weights"
    assert replace(plain, points_mean=np.nan).exceeded(plain) == "curvature at points"


def test_the_comparison_is_on_goals_never_seen_and_gives_the_worst(reach, refined):
    found = refine_quality.compare(reach, refined, 3)
    assert found.new.cost_mean < found.now.cost_mean
    assert found.new.error_max_m < 1e-9
    assert found.planted
    costs = [row["before"]["cost"] for row in found.worst]
    assert costs == sorted(costs, reverse=True)
    at = np.array([[found.worst[0]["adverbs"][adverb.name] for adverb in reach.adverbs]])
    again = MotionCost.of_verb(reach, Evaluator(reach).blend(at).weights).figures(Evaluator(refined).blend(at).weights)
    assert again[0, PEAK] == pytest.approx(found.worst[0]["after"]["peak_m_s2"], rel=1e-6)
    assert json.loads(json.dumps(found.to_json()))["for"] == "quality"


def test_a_version_that_changes_nothing_is_not_better(reach):
    found = refine_quality.compare(reach, reach, 1)
    assert found.reasons == ("its mean cost does not fall by 5 %",)
    assert not found.better
    assert found.text.startswith("not better: its mean cost")


def test_slide_counts_where_feet_are_not_planted(reach):
    now = refine_quality.compare(reach, reach, 1).now
    good = replace(now, cost_mean=0.5 * now.cost_mean)
    assert _reasons(now, good, 0.5, 0.1, stands=False) == []
    slides = replace(good, slide_p90_m=1.2 * now.slide_p90_m)
    assert _reasons(now, slides, 0.5, 0.1, stands=False) == ["feet slide more"]
    assert _reasons(now, slides, 0.5, 0.1, stands=True) == []
    assert _reasons(now, good, 0.5, 0.2, stands=True) == ["too many goals are worse"]
    assert _reasons(now, replace(good, zoom_ratio=2.0), 0.5, 0.1, stands=True) == ["its weights are less smooth"]


def test_what_cannot_be_refined_is_refused(tmp_path):
    styled = build(walker.source(tmp_path / "w", {"a": walker.stand(), "b": walker.stand(2.5)})).verb
    with pytest.raises(RequestError, match="no method 'corrected'"):
        next(iter(refine_quality.refine(styled)))
    with pytest.raises(OutOfRange, match="max_pseudo is 65"):
        Rules(max_pseudo=65)


def test_the_command_refines_exact_verbs_for_quality(tmp_path):
    file = tmp_path / "calm.verb"
    found = CliRunner().invoke(app, ["refine", "arm3", "--max-pseudo", "1", "-o", str(file), "--json"])
    assert found.exit_code == 0, found.output
    report = json.loads(found.stdout)
    assert report["for"] == "quality"
    assert report["comparison"]["new"]["cost_mean"] < report["comparison"]["now"]["cost_mean"]
    assert len(artifact.load(file).bases["smooth"].centers) == len(library.load("arm3").examples) + 1
    shown = CliRunner().invoke(app, ["refine", "arm3", "--max-pseudo", "1", "-o", str(file)])
    assert "mean cost" in shown.stdout
    assert "stopped: most pseudo-examples reached" in shown.stdout


def test_the_command_refines_for_error_on_request(tmp_path):
    file = tmp_path / "fine.verb"
    for more in (["--for", "error"], ["--target-error", "0.5"], ["--planes", "refit"]):
        found = CliRunner().invoke(app, ["refine", "arm3", "--max-pseudo", "2", "-o", str(file), "--json", *more])
        report = json.loads(found.stdout)
        assert report["for"] == "error"
        assert report["curve"][-1]["pseudo"] == 2
        assert "refined" in artifact.load(file).bases
    assert CliRunner().invoke(app, ["refine", "arm3", "--for", "fun"]).exit_code != 0


@pytest.mark.slow
def test_the_captured_kick_whips_less(mocap, verb_of):
    verb = verb_of("kick")
    steps = list(refine_quality.refine(verb, Rules(max_pseudo=3)))
    found = refine_quality.compare(verb, refine_quality.with_basis(verb, steps[-1].basis, Rules(), steps[-1].mark), 1)
    assert found.new.peak_p95_m_s2 < 0.75 * found.now.peak_p95_m_s2
    assert found.new.over_ratio < 0.7 * found.now.over_ratio
    assert found.new.error_max_m < 1e-9
    assert found.better
