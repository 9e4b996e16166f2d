"""Adverb's library: verbs as Rose, Sloan and Cohen describe them, exact and smooth at once."""

from verbs.characters import Characters, Frames
from verbs.errors import VerbError
from verbs.evaluate import Blend, Evaluator, Poses
from verbs.motion import Motion
from verbs.skeleton import Skeleton
from verbs.verb import Adverb, Basis, Chart, Domain, Measure, Verb

__all__ = [
    "Adverb",
    "Basis",
    "Blend",
    "Characters",
    "Chart",
    "Domain",
    "Evaluator",
    "Frames",
    "Measure",
    "Motion",
    "Poses",
    "Skeleton",
    "Verb",
    "VerbError",
]
