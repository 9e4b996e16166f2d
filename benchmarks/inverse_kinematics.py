"""Cost of reaching a point: corrected blending, inverse blending, and general inverse kinematics (mink).

mink solves another problem: from the rest pose it finds some pose that reaches, and knows nothing of the examples. It
is what one would use in the examples' place; its time includes its Python loop, as it would in use.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.timing import interleave
from verbs import Evaluator, library
from verbs.blend.corrected import Corrected
from verbs.blend.inverse import Inverse
from verbs.domain import random_points
from verbs.skeleton import Skeleton

EFFECTOR = "RightHand"
TARGETS = 100
SOLVED = 10
"""Targets that mink is timed on, the first ones: it is slow, and its mean settles early."""

STOP_M = 1e-5
ITERATIONS = 60
GOALS = {"mink": 100, "inverse": 40}


def mjcf(skeleton: Skeleton, root: np.ndarray) -> str:
    """MuJoCo model of a skeleton in its rest pose, its root held at a place (3,), with a ball in each other joint."""
    children: dict[int, list[int]] = {j: [] for j in range(len(skeleton))}
    for j, parent in enumerate(skeleton.parents[1:], start=1):
        children[int(parent)].append(j)

    def body(j: int) -> str:
        x, y, z = root if j == 0 else skeleton.offsets[j]
        ball = "" if j == 0 else '<joint type="ball"/>'
        inside = "".join(body(child) for child in children[j])
        mass = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
        return f'<body name="{skeleton.names[j]}" pos="{x} {y} {z}">{mass}{ball}{inside}</body>'

    return f'<mujoco><compiler angle="radian"/><worldbody>{body(0)}</worldbody></mujoco>'


def _mink_solver(skeleton: Skeleton, root: np.ndarray) -> Callable[[np.ndarray], tuple[float, int]]:
    """A function from a target (3,) to the error that is left (m) and the iterations taken."""
    import mink
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf(skeleton, root))
    configuration = mink.Configuration(model)
    rest = configuration.q.copy()
    task = mink.FrameTask(EFFECTOR, "body", position_cost=1.0, orientation_cost=0.0)

    def solve(target: np.ndarray) -> tuple[float, int]:
        configuration.update(rest)
        task.set_target(mink.SE3.from_translation(target))
        error = np.inf
        for k in range(ITERATIONS + 1):
            hand = configuration.get_transform_frame_to_world(EFFECTOR, "body").translation()
            error = float(np.linalg.norm(hand - target))
            if error <= STOP_M or k == ITERATIONS:
                return error, k
            velocity = mink.solve_ik(configuration, [task], dt=1.0, solver="daqp", damping=1e-6, limits=[])
            configuration.integrate_inplace(velocity, 1.0)
        return error, ITERATIONS

    return solve


def _mink() -> Callable[[Skeleton, np.ndarray], Callable[[np.ndarray], tuple[float, int]]] | None:
    """Factory of a solver; prints a note and returns None if mink is not installed."""
    try:
        import daqp
        import mink  # noqa: F401  (only whether it is there)
    except ImportError:
        print("  mink is not installed: .venv/bin/uv pip install mink daqp")
        return None
    del daqp
    return _mink_solver


def _report(name: str, microseconds: float, errors: np.ndarray, *, note: str = "") -> None:
    worst, median = 1e3 * float(errors.max()), 1e3 * float(np.median(errors))
    print(f"  {name:<24}{microseconds:>12.2f} µs each, error {median:.1g} mm (median), {worst:.1g} mm (worst){note}")


def main() -> None:
    """Print one table."""
    verb = library.load("reach")
    rows = random_points(verb, np.random.default_rng(0), TARGETS)
    methods = {
        "corrected, K=3": Corrected.of_verb(verb, steps=3),
        "corrected": Corrected.of_verb(verb),
        "inverse": Inverse.of_verb(verb),
    }
    goal = methods["corrected"].goal
    targets = goal.points(rows)
    print(f"inverse kinematics: {TARGETS} targets inside reach, {EFFECTOR}, {len(verb.skeleton)} joints")
    evaluator, phase = Evaluator(verb), float(verb.phases[verb.measure.keytime])
    tasks: dict[str, Callable[[], object]] = {name: partial(method.weights, rows) for name, method in methods.items()}
    tasks["corrected, with pose"] = lambda: evaluator.pose(rows, phase=phase)
    make = _mink()
    solve = make(verb.skeleton, goal.chain.roots.mean(axis=1)) if make else None
    if solve:
        tasks["mink"] = lambda: [solve(target) for target in targets[:SOLVED]]
    best = interleave(tasks, rounds=20)
    each = {name: 1e6 * seconds / (SOLVED if name == "mink" else TARGETS) for name, seconds in best.items()}
    for name, method in methods.items():
        errors = np.linalg.norm(goal.measured(method.weights(rows)) - targets, axis=1)
        _report(name, each[name], errors)
    print(f"  {'corrected, with pose':<24}{each['corrected, with pose']:>12.2f} µs each")
    if solve:
        found = np.array([solve(target) for target in targets[:SOLVED]])
        note = f", {found[:, 1].mean():.1f} iterations; first {SOLVED} targets"
        _report("mink", each["mink"], found[:, 0], note=note)
    _ratios(each)


def _ratios(each: dict[str, float]) -> None:
    """Weights against weights; mink, which ends with a pose, against the pose as well."""
    own = {"mink": ("corrected, K=3", "corrected", "corrected, with pose"), "inverse": ("corrected, K=3", "corrected")}
    for other, least in GOALS.items():
        for name in own[other] if other in each else ():
            ratio = each[other] / each[name]
            print(f"  {other} / {name}: {ratio:.1f}× (goal ≥ {least}×: {'met' if ratio >= least else 'not met'})")


if __name__ == "__main__":
    main()
