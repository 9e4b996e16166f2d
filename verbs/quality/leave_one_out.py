"""Leave-one-out: difference between an example's pose and its prediction from the others.

Most left-out examples lie on the hull of all, so this is extrapolation: it compares methods with the examples and
is not the error inside the domain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from verbs.authoring import basis as bases
from verbs.authoring.source import TAILS
from verbs.conventions import F64
from verbs.errors import IllPosedVerb
from verbs.kernels import measure as measures
from verbs.kernels import quat
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Chart, Verb

__all__ = ["LeftOut", "leave_one_out", "left_out_errors", "subset", "suggested_tail"]

TAIL_GAIN = 0.03
"""Share by which the mean angle of left-out examples has to fall for a tail to be suggested."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Mean joint angle (rad) and goal error (the measure's unit) between left-out examples and their predictions."""

    method: str
    angle_mean_rad: float
    error_mean: float


def subset(verb: Verb, kept: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Verb:
    """A verb of some of its examples; domain and bases are solved again, in charts of the same kind."""
    values = np.ascontiguousarray(verb.values[kept])
    smooth = verb.bases.get("smooth")
    chart = _rescaled(verb.domain.chart, verb, values)
    fields = {"rbf": bases.cardinal(_rescaled(verb.bases["rbf"].chart, verb, values), values)}
    if smooth is not None:
        fields["smooth"] = bases.smooth(chart, values, degree=smooth.degree)
    return replace(
        verb,
        examples=tuple(verb.examples[i] for i in kept),
        values=values,
        keytimes=np.ascontiguousarray(verb.keytimes[kept]),
        curves=np.ascontiguousarray(verb.curves[:, kept]),
        strides=np.ascontiguousarray(verb.strides[:, kept]),
        domain=bases.domain_of(chart, values),
        bases=fields,
        provenance={key: value for key, value in verb.provenance.items() if key != "simplices"},
        contacts=None if verb.contacts is None else verb.contacts.subset(kept),
    )


def _rescaled(chart: Chart, verb: Verb, values: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> Chart:
    """The same bend over other examples, shifted and scaled to them."""
    units = tuple(adverb.unit for adverb in verb.adverbs)
    return bases.chart_of(values, units, kind=chart.kind, axes=chart.axes, bend=chart.bend)


def leave_one_out(verb: Verb, methods: tuple[str, ...]) -> list[LeftOut]:
    """Predict each example from the others, by each method; the means of :func:`left_out_errors`."""
    angles, errors = left_out_errors(verb, methods)
    return [LeftOut(name, float(angles[m].mean()), float(errors[m].mean())) for m, name in enumerate(methods)]


def left_out_errors(verb: Verb, methods: tuple[str, ...]) -> tuple[F64, F64]:
    """Mean joint angles (rad) and goal errors (the measure's unit) of each left-out example, (methods, N) both.

    The pose compared is the one at the effector's keytime, or the mean over ten phases where there is none. Goals are
    not clamped to the smaller domain.
    """
    count = len(verb.examples)
    keytime = verb.measure.keytime
    phases = verb.phases[[keytime]] if verb.measure.kind == measures.POSITION else np.linspace(0.05, 0.95, 10)
    angles, errors = np.zeros((len(methods), count)), np.zeros((len(methods), count))
    for i in range(count):
        true = Evaluator(verb)
        unit = np.eye(count)[i : i + 1]
        blend = true.measure("example", unit, verb.values[i : i + 1], np.zeros(1, bool))
        own = true.pose_of(blend, phase=phases, plant=False)
        other = Evaluator(subset(verb, np.delete(np.arange(count), i)))
        for m, name in enumerate(methods):
            weights = other.method(name)[1].weights(verb.values[i : i + 1].copy())
            blend = other.measure(name, weights, verb.values[i : i + 1], np.zeros(1, bool))
            shown = other.pose_of(blend, phase=phases, plant=False)
            differences = quat.log(quat.mul(quat.conjugate(own.rotations), shown.rotations))
            angles[m, i] = np.linalg.norm(differences, axis=-1).mean()
            errors[m, i] = blend.error[0]
    return angles, errors


def suggested_tail(verb: Verb) -> str:
    """A sentence that suggests the other polynomial part of the smooth basis; empty where it predicts no better.

    Examples are left out and predicted by ``corrected`` with an affine and with a constant part.
    """
    own = verb.bases.get("smooth")
    if own is None:
        return ""
    other = bases.smooth(own.chart, verb.values, degree=1 - own.degree)
    try:
        (now,), (new,) = (leave_one_out(replace(verb, bases={**verb.bases, "smooth": one}), ("corrected",))
                          for one in (own, other))  # fmt: skip
    except IllPosedVerb:  # too few examples to leave one out
        return ""
    if not new.angle_mean_rad < (1.0 - TAIL_GAIN) * now.angle_mean_rad:
        return ""
    angles = [np.degrees(one.angle_mean_rad) for one in (now, new)]
    return (
        f'with tail = "{TAILS[other.degree]}" examples that are left out are predicted to {angles[1]:.2f}° of each '
        f"joint instead of {angles[0]:.2f}°"
    )
