import numpy as np
import pytest

from verbs.kernels import measure, root_velocity, timewarp
from verbs.kernels.corrected_velocity import velocity_jacobian
from verbs.kernels.pose import stride_to
from verbs.kernels.timewarp import Clock

LOOPS = [
    (220, 19, (0.0, 0.27, 0.5, 0.77, 1.0)),
    (16, 4, (0.0, 1.0)),
    (33, 5, (0.0, 0.31, 1.0)),
    (7, 1, (0.0, 0.5, 1.0)),
]


def loop(steps, count, phases, *, turn=0.02, seed=0):
    """Strides (K, N, 4), keytimes' phases and logarithms of segment lengths; examples turn by as much as 3·K·turn."""
    rng = np.random.default_rng(seed)
    strides = rng.normal(size=(steps, count, 4)) * (0.01, 0.01, turn, 0.01) + (0.0, 0.01, turn, 0.003)
    lengths = rng.uniform(0.2, 0.8, size=(count, len(phases) - 1))
    return strides, np.array(phases), np.log(lengths)


def blends(count, rows, seed=1):
    """Weights (rows, count) that sum to 1, some negative."""
    weights = np.random.default_rng(seed).normal(size=(rows, count))
    return weights - (weights.sum(axis=1, keepdims=True) - 1.0) / count


def speeds_as_defined(weights, strides, phases, log_lengths):
    """Every step turned into the frame of the mean rate, one after the other, and averaged over the cycle."""
    keytimes, tangents = np.empty(len(phases)), np.empty(len(phases))
    timewarp.blend_keytimes(weights, log_lengths, keytimes)
    timewarp.slopes(phases, keytimes, True, tangents)
    steps = np.einsum("i,kia->ka", weights, strides)
    times = [timewarp.time_at(phases, keytimes, tangents, k / len(steps)) for k in range(len(steps) + 1)]
    rate = steps[:, 2].sum() / keytimes[-1]
    heading, total = 0.0, 0.0j
    for k, (side, ahead, turn, _) in enumerate(steps):
        angle = heading + 0.5 * turn - rate * 0.5 * (times[k] + times[k + 1])
        total += complex(ahead, side) * np.exp(1j * angle)
        heading += turn
    return np.array([total.real, rate * keytimes[-1], total.imag]) / keytimes[-1]


@pytest.mark.parametrize("shape", LOOPS)
@pytest.mark.parametrize("turn", [0.0, 0.02, 0.3])
def test_speeds_are_those_of_the_definition(shape, turn):
    strides, phases, log_lengths = loop(*shape, turn=turn)
    cycle, weights = root_velocity.cycle_of(strides, Clock(phases, log_lengths, True)), blends(shape[1], 20)
    measured = np.empty((20, 3))
    measure.root_velocities(weights, cycle, measured)
    wanted = [speeds_as_defined(row, strides, phases, log_lengths) for row in weights]
    np.testing.assert_allclose(measured, wanted, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("shape", LOOPS)
def test_jacobian_equals_central_differences(shape):
    strides, phases, log_lengths = loop(*shape)
    clock, count = Clock(phases, log_lengths, True), shape[1]
    cycle = root_velocity.cycle_of(strides, clock)
    point, jacobian, ends = np.empty(3), np.empty((3, count)), np.empty((2, count, 3))
    for weights in blends(count, 5):
        velocity_jacobian(weights, strides, clock, point, jacobian)
        steps = 1e-5 * np.eye(count)
        for way, sign in enumerate((1.0, -1.0)):
            measure.root_velocities(weights + sign * steps, cycle, ends[way])
        np.testing.assert_allclose(jacobian, (ends[0] - ends[1]).T / 2e-5, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(point, speeds_as_defined(weights, strides, phases, log_lengths), atol=1e-12)


def test_sines_are_exact_at_any_angle():
    angles = np.concatenate([np.linspace(-40.0, 40.0, 4001), np.arange(-8, 9) * 0.5 * np.pi])
    steps = np.zeros((5, len(angles)))
    steps[root_velocity.ANGLE] = angles
    root_velocity._sines(steps)
    np.testing.assert_allclose(steps[root_velocity.SINE], np.sin(angles), atol=3e-15)
    np.testing.assert_allclose(steps[root_velocity.COSINE], np.cos(angles), atol=3e-15)


def walked_as_defined(weights, strides, keys):
    """Place after whole intervals of a loop: at each its blended step, in the frame of its heading half way."""
    place, heading, height = 0.0j, 0.0, 0.0
    for side, ahead, turn, rise in np.einsum("i,kia->ka", weights, strides)[np.arange(keys) % len(strides)]:
        place += complex(ahead, side) * np.exp(1j * (heading + 0.5 * turn))
        heading += turn
        height += rise
    return np.array([place.imag, place.real, heading, height])


def test_walking_whole_intervals_adds_the_blended_steps():
    strides, _, _ = loop(*LOOPS[0])
    for weights in blends(19, 3):
        for keys in (0, 1, 219, 220, 500):
            place = np.zeros(4)
            stride_to(weights, strides, 0.0, keys / 220, True, place)
            np.testing.assert_allclose(place, walked_as_defined(weights, strides, keys), atol=1e-11)


@pytest.mark.parametrize("looping", [True, False])
def test_walking_from_key_to_key_equals_walking_at_once(looping):
    strides, _, _ = loop(*LOOPS[2])
    weights, parts, whole = blends(5, 1)[0], np.zeros(4), np.zeros(4)
    for k in range(33):
        stride_to(weights, strides, k / 33, (k + 1) / 33, looping, parts)
    stride_to(weights, strides, 0.0, 1.0, looping, whole)
    np.testing.assert_allclose(parts, whole, atol=1e-12)
