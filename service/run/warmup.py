"""Imports and kernels that servers, sandboxes and refiners need, loaded before any of them is forked.

``python -m service.run.warmup`` compiles the kernels, on two cores, and keeps them on disk.
"""

from __future__ import annotations

import logging
import subprocess
import sys
from dataclasses import replace
from functools import cache
from itertools import islice

import structlog

__all__ = ["load_building", "load_serving", "main"]

METHODS = "methods"
"""Argument of the process that compiles the kernels of methods, which takes as long as all others together."""


@cache
def load_serving() -> None:
    """Import the app, and load or compile the kernels of requests and streams."""
    import httptools  # noqa: F401 - uvicorn imports it by name
    import uvloop  # noqa: F401 - the same

    from service import packing
    from service.catalog import catalog
    from service.run import server  # noqa: F401
    from service.stream import kernels

    packing.warm()
    kernels.warm()
    catalog.load(None)
    _load_mappings()


@cache
def load_building() -> None:
    """Import what sandboxes and refiners use, and load or compile their kernels."""
    from service.refinement.worker import main as worker  # noqa: F401
    from service.upload import sandbox  # noqa: F401
    from verbs import library, refine, refine_quality
    from verbs.authoring.fit import build
    from verbs.proposal.propose import propose
    from verbs.quality import foot_contact
    from verbs.runtime.evaluate import Evaluator

    for name in ("arm3", "reach"):
        build(library.source(name))
    propose(library.source("reach"))
    for _ in islice(refine.refine(library.load("arm3")), 2):
        pass
    reach = library.load("reach")
    for _ in islice(refine_quality.refine(reach, refine_quality.Rules(samples=40)), 2):
        pass
    evaluator = Evaluator(reach)
    if known := foot_contact.contacts(evaluator):
        foot_contact.slides(evaluator, known, reach.values[:1])
    _load_measures()


def _load_measures() -> None:
    """Load or compile the kernels of measures that no built-in verb has.

    These are the velocity of a loop, a jump's apex, and measures that adverbs name for themselves.
    """
    import numpy as np

    from verbs import library
    from verbs.adverb_measure import AdverbMeasure, Span
    from verbs.kernels import measure, pose
    from verbs.runtime.characters import Characters
    from verbs.runtime.evaluate import Evaluator
    from verbs.runtime.ground import gradient
    from verbs.verb import Measure

    arm, reach = library.load("arm3"), library.load("reach")
    velocity = replace(
        arm,
        looping=True,
        root_motion=pose.STRIDE,
        strides=np.full((len(arm.curves) - 3, len(arm.examples), 4), 0.01),
        measure=replace(arm.measure, kind=measure.VELOCITY, keytime=-1),
    )
    jump = replace(reach, measure=replace(reach.measure, kind=measure.JUMP))
    at = (Span(arm.measure.effector, float(arm.phases[arm.measure.keytime])),)
    rows = tuple(AdverbMeasure("position", axis, at, 1.0) for axis in "xy")
    own = Measure(measure.ADVERBS, 0, -1, arm.measure.axes, np.zeros(3), np.zeros((3, len(rows))), rows)
    for verb in (velocity, jump, replace(arm, measure=own)):
        evaluator = Evaluator(verb)
        evaluator.warm()
        Characters(evaluator).warm()
        gradient(evaluator, evaluator.blend(verb.values[:1]))


def main() -> None:
    """Load everything once, while another process compiles the methods; each finds what the other has kept."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    if sys.argv[1:] == [METHODS]:
        _compile_methods()
        return
    with subprocess.Popen([sys.executable, "-m", "service.run.warmup", METHODS]):
        _compile_streams()
        load_building()
        _load_mappings()
    load_serving()


def _load_mappings() -> None:
    """Load or compile the kernels of poses on other skeletons."""
    from verbs import library
    from verbs.mapping.mapper import Mapper
    from verbs.mapping.mapping import of_preset
    from verbs.runtime.evaluate import Evaluator

    evaluator = Evaluator(library.load("reach"))
    Mapper.of_verb(evaluator, of_preset("vrm")).poses(evaluator.pose(evaluator.verb.values[:1], phase=0.0))


def _compile_streams() -> None:
    """Compile the kernels of streams."""
    from service import packing
    from service.stream import kernels
    from verbs import library
    from verbs.runtime.characters import Characters
    from verbs.runtime.evaluate import Evaluator

    packing.warm()
    kernels.warm()
    for name in ("arm3", "reach"):
        Characters(Evaluator(library.load(name))).warm()


def _compile_methods() -> None:
    """Compile the kernels of batches and of the methods that streams do not need."""
    import numpy as np

    from verbs import library
    from verbs.kernels.columns import BATCH
    from verbs.runtime.evaluate import Evaluator

    evaluator = Evaluator(library.load("arm3"))
    evaluator.blend(np.resize(evaluator.verb.values, (BATCH, len(evaluator.verb.adverbs))))
    for method in ("inverse", "barycentric", "knn"):
        evaluator.blend(evaluator.verb.values[:1], method=method)


if __name__ == "__main__":
    main()
