"""Characters of captured verbs, shared by the tests of a file."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import pytest

from verbs import Characters, Evaluator, Verb


@pytest.fixture(scope="module")
def characters_of(verb_of: Callable[[str], Verb]) -> Callable[[str], Characters]:
    """Characters of a verb by its name, created once for each file."""
    return lru_cache(maxsize=None)(lambda name: Characters(Evaluator(verb_of(name))))
