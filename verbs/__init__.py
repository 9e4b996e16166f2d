"""Parameterised motions (verbs) from example motions: build, load, evaluate.

Source: Rose, Sloan, Cohen 2001; Feng, Huang, Kallmann, Shapiro 2012; ``docs/math.md`` has every formula.

Public names; each docstring gives shapes, units and errors:

- :func:`build` a verb from a source folder (:class:`Built`); :func:`load` and :func:`save` a ``.verb`` file.
- :class:`Verb` with its parts :class:`Adverb`, :class:`Skeleton`, :class:`Measure`, :class:`Domain`, :class:`Chart`,
  :class:`Basis`, :class:`Contacts`: arrays in metres, seconds and radians; adverbs in their declared unit.
- :class:`Evaluator`: adverbs (B, D) to a :class:`Blend`, weights (B, N) with error, and to :class:`Poses`, roots (B, 3)
  and rotations (B, J, 4).
- :class:`Characters`: state of many characters over time; a step gives :class:`Frames`.
- :class:`Motion`: root (F, 3) and rotations (F, J, 4) of one clip.
- :class:`VerbError`: base class of all errors, see :mod:`verbs.errors`.

Built-in verbs are in :mod:`verbs.library`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from verbs.authoring.fit import Built, build
    from verbs.contacts import Contacts
    from verbs.errors import VerbError
    from verbs.io.artifact import load, save
    from verbs.motion import Motion
    from verbs.runtime.characters import Characters, Frames
    from verbs.runtime.evaluate import Blend, Evaluator, Poses
    from verbs.skeleton import Skeleton
    from verbs.verb import Adverb, Basis, Chart, Domain, Measure, Verb

__all__ = [
    "Adverb",
    "Basis",
    "Blend",
    "Built",
    "Characters",
    "Chart",
    "Contacts",
    "Domain",
    "Evaluator",
    "Frames",
    "Measure",
    "Motion",
    "Poses",
    "Skeleton",
    "Verb",
    "VerbError",
    "build",
    "load",
    "save",
]

_MODULES = {
    "authoring.fit": ("Built", "build"),
    "contacts": ("Contacts",),
    "errors": ("VerbError",),
    "io.artifact": ("load", "save"),
    "motion": ("Motion",),
    "runtime.characters": ("Characters", "Frames"),
    "runtime.evaluate": ("Blend", "Evaluator", "Poses"),
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
    return sorted(__all__)
