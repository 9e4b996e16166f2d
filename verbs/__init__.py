"""Parameterised motions (verbs) from example motions: build, evaluate, refine.

Source: Rose, Sloan, Cohen 2001; Feng, Huang, Kallmann, Shapiro 2012.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from verbs.errors import VerbError
    from verbs.motion import Motion
    from verbs.runtime.characters import Characters, Frames
    from verbs.runtime.evaluate import Blend, Evaluator, Poses
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

_MODULES = {
    "runtime.characters": ("Characters", "Frames"),
    "errors": ("VerbError",),
    "runtime.evaluate": ("Blend", "Evaluator", "Poses"),
    "motion": ("Motion",),
    "skeleton": ("Skeleton",),
    "verb": ("Adverb", "Basis", "Chart", "Domain", "Measure", "Verb"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name on first use: Numba and SciPy take seconds, and `adverb --help` needs neither."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
