"""Verbs made for tests of weights: examples at given places of an adverb space, and the same verb in another order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from verbs import library
from verbs.authoring import basis as bases
from verbs.kernels import measure as measures
from verbs.verb import Adverb, Measure


def verb_at(values, *, simplices=()):
    """A verb with unmeasured adverbs ``values`` (N, D); its motions are those of the arm, over and over."""
    values = np.ascontiguousarray(values, np.float64)
    arm, (count, dims) = library.load("arm3"), values.shape
    order = np.arange(count) % len(arm.examples)
    ranges = zip(values.min(axis=0), values.max(axis=0), strict=True)
    chart = bases.chart_of(values, ("",) * dims)
    return replace(
        arm,
        adverbs=tuple(Adverb(f"a{k}", "", "", False, low, high) for k, (low, high) in enumerate(ranges)),
        examples=tuple(f"e{k}" for k in range(count)),
        values=values,
        keytimes=arm.keytimes[order],
        curves=np.ascontiguousarray(arm.curves[:, order]),
        strides=np.zeros((0, count, 4)),
        measure=Measure(measures.NOTHING, 0, -1, np.empty(0, np.int64), np.zeros(3), np.zeros((3, 0))),
        domain=bases.domain_of(chart, values),
        bases={"rbf": bases.cardinal(chart, values)},
        provenance={"simplices": [list(row) for row in simplices]},
    )


def permuted(verb, order):
    """The same verb with its examples in another order."""
    place = np.argsort(order)
    simplices = [[int(place[item]) for item in row] for row in verb.provenance.get("simplices", ())]
    return replace(
        verb,
        examples=tuple(verb.examples[k] for k in order),
        values=np.ascontiguousarray(verb.values[order]),
        keytimes=np.ascontiguousarray(verb.keytimes[order]),
        curves=np.ascontiguousarray(verb.curves[:, order]),
        strides=np.ascontiguousarray(verb.strides[:, order]),
        bases={"rbf": bases.cardinal(verb.bases["rbf"].chart, verb.values[order])},
        provenance={"simplices": simplices},
    )


def grid(side, dims):
    """Corners of a regular grid over the unit cube: the worst case of a Delaunay triangulation."""
    axes = np.meshgrid(*[np.linspace(0.0, 1.0, side)] * dims, indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, dims)
