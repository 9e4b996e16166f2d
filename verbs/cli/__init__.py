"""The command ``adverb``: build, inspect, measure, refine and export verbs, and draw the papers' figures.

One module per group of commands. A command imports what it computes with when it runs: Numba and SciPy take seconds
to import, and `adverb --help` needs neither.
"""

from verbs.cli.application import app, main, run

__all__ = ["app", "main", "run"]
