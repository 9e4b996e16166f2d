"""Support of answers by the examples."""

from dataclasses import replace

import numpy as np
import pytest

from tests.verbs.sources import arm_motion, example_row, write_source
from verbs import Evaluator, library
from verbs.authoring import basis as bases
from verbs.authoring.fit import build
from verbs.blend import methods
from verbs.blend.cardinal import basis_weights
from verbs.domain import random_points
from verbs.errors import RequestError
from verbs.kernels import measure as measures
from verbs.kernels import radial_basis
from verbs.quality.leave_one_out import subset
from verbs.runtime.support import Support

NO_AXES = np.zeros(0, np.int64)


@pytest.fixture(scope="module", params=["arm3", "board", "reach"])
def evaluator(request):
    return Evaluator(library.load(request.param))


@pytest.fixture(scope="module")
def reach():
    return Evaluator(library.load("reach"))


def goals(verb, count=300, seed=0, gauge=(0.0, 1.0)):
    return random_points(verb, np.random.default_rng(seed), count, gauge=gauge)


def support(evaluator, adverbs, method=None):
    return evaluator.support(evaluator.blend(adverbs, method=method))


def test_examples_support_themselves_fully_by_every_method(evaluator):
    for method in methods.usable(evaluator.verb):
        if method == "inverse":  # it meets an example's goal by other examples
            continue
        np.testing.assert_allclose(support(evaluator, evaluator.verb.values, method), 1.0, atol=1e-6, err_msg=method)


def test_everywhere_else_support_is_between_zero_and_one(evaluator):
    for method in methods.usable(evaluator.verb):
        found = support(evaluator, goals(evaluator.verb, 50, gauge=(0.0, 1.5)), method)
        assert found.min() > 0.0
        assert found.max() < 1.0
        assert np.ptp(found) > 0.05


def test_one_half_is_an_example_predicted_from_the_others_in_the_median():
    """The closed form of the leave-one-out variance against predictions from the others, solved one by one."""
    verb = library.load("reach")
    whole = Support.of_verb(verb).arrays
    left_out = []
    for i in range(len(verb.examples)):
        kept = np.delete(np.arange(len(verb.examples)), i)
        between, at = whole.between[np.ix_(kept, kept)], whole.between[kept, i]
        system = np.block([[-between, np.ones((len(kept), 1))], [np.ones((1, len(kept))), np.zeros((1, 1))]])
        weights = np.linalg.solve(system, np.append(-at, 1.0))[:-1]
        left_out.append(2.0 * weights @ at - weights @ between @ weights)
    assert whole.half == pytest.approx(np.median(left_out), rel=1e-9)


def test_weights_of_the_smooth_basis_give_its_power_function(reach):
    """Against P² = φ(0) + kᵀ w + pᵀ λ of the saddle-point system, the textbook form of the power function."""
    verb, basis = reach.verb, reach.verb.bases["smooth"]
    found, adverbs = Support.of_verb(verb).arrays, goals(verb, 40)
    points = basis.chart.points(adverbs)
    phi = radial_basis.radial_matrix(radial_basis.MULTIQUADRIC, basis.centers, basis.centers, basis.radii)
    powers = radial_basis.polynomial_matrix(basis.centers, 1)
    width = powers.shape[1]
    system = np.block([[phi, powers], [powers.T, np.zeros((width, width))]])
    right = np.concatenate(
        [
            radial_basis.radial_matrix(radial_basis.MULTIQUADRIC, points, basis.centers, basis.radii),
            radial_basis.polynomial_matrix(points, 1),
        ],
        axis=1,
    )
    power = -1.0 - np.einsum("bi,bi->b", right, np.linalg.solve(system, right.T).T)
    ours = Support.of_verb(verb).of(adverbs, basis_weights(basis, adverbs))
    np.testing.assert_allclose(found.half * (1.0 / ours - 1.0), power, rtol=1e-7)


def test_support_falls_from_an_example_to_the_middle_of_a_gap_and_on_outside(tmp_path):
    evaluator = Evaluator(build(nodding(tmp_path, [0.1, 0.4, 0.7, 1.3], "rad")).verb)
    gap, beyond = np.linspace(0.7, 1.0, 20)[:, None], np.linspace(1.3, 4.0, 40)[:, None]
    assert np.all(np.diff(support(evaluator, gap)) < 0)
    assert np.all(np.diff(support(evaluator, beyond)) < 0)
    assert support(evaluator, beyond)[-1] < 0.1
    middles = support(evaluator, np.array([[0.25], [0.55], [1.0]]))
    assert middles[2] < middles[:2].min()  # the widest gap


def test_without_a_neighbour_the_others_have_less_support(reach):
    """Leaving out examples never raises the power function; support of the same scale falls."""
    verb, kept = reach.verb, np.arange(0, len(reach.verb.examples), 2)
    fewer = replace(subset(verb, kept), domain=verb.domain)
    adverbs = verb.values[1::2]
    assert support(Evaluator(fewer), adverbs).max() < 0.9
    assert support(reach, adverbs).min() > 1.0 - 1e-6


def test_cancelling_weights_lower_support(reach):
    one = goals(reach.verb, 1)
    weights, extra = reach.blend(one).weights, np.zeros((1, len(reach.verb.examples)))
    extra[0, [0, 9]] = 1.0, -1.0
    found = [float(Support.of_verb(reach.verb).of(one, weights + much * extra)[0]) for much in (0.0, 1.0, 2.0, 4.0)]
    assert np.all(np.diff(found) < 0)


@pytest.mark.parametrize("method", ["corrected", "rbf"])
def test_support_is_smooth_across_examples(reach, method):
    """Second differences shrink by four where the step is halved: no kink, not even at an example."""
    verb = reach.verb
    inner = verb.values[np.argmin(np.linalg.norm(verb.values - verb.values.mean(axis=0), axis=1))]
    along = np.array([0.6, 0.3, -0.5])
    bends = []
    for step in (2e-3, 1e-3):
        line = inner + step * np.arange(-20, 21)[:, None] * along
        bends.append(np.abs(np.diff(support(reach, line, method), n=2)).max())
    assert bends[0] / bends[1] > 3.0


def test_units_of_the_adverbs_do_not_matter(tmp_path):
    angles = [0.1, 0.4, 0.7, 1.3]
    radians = Evaluator(build(nodding(tmp_path / "rad", angles, "rad")).verb)
    degrees = Evaluator(build(nodding(tmp_path / "deg", np.degrees(angles).tolist(), "deg", angles)).verb)
    at = np.linspace(0.0, 1.6, 30)[:, None]
    np.testing.assert_allclose(support(radians, at), support(degrees, np.degrees(at)), rtol=1e-9)


def test_a_rotation_of_the_space_does_not_matter(reach):
    """The same examples with turned adverbs, in a chart of the identity, by the weights of a radial basis."""
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    units, values = ("m",) * 3, reach.verb.values
    found = []
    for spin in (np.eye(3), turn):
        chart = bases.chart_of(values @ spin, units)
        verb = replace(reach.verb, values=values @ spin, domain=bases.domain_of(chart, values @ spin))
        at = goals(reach.verb, 50) @ spin
        found.append(Support.of_verb(verb).of(at, basis_weights(bases.smooth(chart, values @ spin), at)))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-8)


def test_a_batch_gives_what_its_rows_give_alone(evaluator):
    adverbs = goals(evaluator.verb, 40)
    weights, every = evaluator.blend(adverbs).weights, Support.of_verb(evaluator.verb)
    alone = [every.of(adverbs[k : k + 1], weights[k : k + 1])[0] for k in range(len(adverbs))]
    np.testing.assert_array_equal(every.of(adverbs, weights), alone)


@pytest.mark.parametrize("dims", range(1, 9))
def test_it_works_in_any_dimension_and_with_as_few_examples_as_a_verb_may_have(reach, dims):
    count = dims + 1
    values = np.random.default_rng(dims).uniform(size=(count, dims))
    adverbs = tuple(replace(reach.verb.adverbs[0], name=f"a{k}", style=True) for k in range(dims))
    chart = bases.chart_of(values, ("none",) * dims)
    found = Support.of_verb(
        replace(
            reach.verb,
            adverbs=adverbs,
            examples=reach.verb.examples[:count],
            values=values,
            keytimes=reach.verb.keytimes[:count],
            curves=np.ascontiguousarray(reach.verb.curves[:, :count]),
            strides=np.ascontiguousarray(reach.verb.strides[:, :count]),
            contacts=None,
            measure=replace(reach.verb.measure, kind=measures.NOTHING, axes=NO_AXES, frame=np.zeros((3, 0))),
            domain=bases.domain_of(chart, values),
            bases={"rbf": bases.cardinal(chart, values)},
        )
    )
    np.testing.assert_allclose(found.of(values, np.eye(count)), 1.0, atol=1e-9)
    mean = found.of(values.mean(axis=0, keepdims=True), np.full((1, count), 1.0 / count))[0]
    assert 0.1 < mean < 0.9


def test_support_needs_the_goals(reach):
    with pytest.raises(RequestError, match="adverbs"):
        reach.support(replace(reach.blend(goals(reach.verb, 1)), adverbs=None))


def nodding(folder, values, unit, angles=None):
    """A verb of one style adverb."""
    head = f'name = "nod"\nkeytime_names = ["start", "low", "end"]\n[[adverb]]\nname = "angle"\nunit = "{unit}"\n'
    rows = [example_row(f"e{k}", [0.0, 0.5, 1.0], [value]) for k, value in enumerate(values)]
    motions = {f"e{k}": arm_motion(angle, 0.0) for k, angle in enumerate(angles or values)}
    return write_source(folder / "nod", motions, rows, head + "style = true\n")
