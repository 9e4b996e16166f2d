from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads spin, and xdist already uses every core
os.environ.setdefault(
    "ADVERB_REFINERS", "0"
)  # a worker beside every server that a test starts would do nothing but load
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import pytest
from hypothesis import settings

from tests.warm import Warm, warm
from verbs.authoring.fit import build
from verbs.verb import Verb

settings.register_profile("fixed", derandomize=True)  # the gate must not depend on luck; hunt with another profile
settings.load_profile("fixed")

PROJECT = Path(__file__).parents[1]


@pytest.fixture(scope="session", autouse=True)
def _close_warm_parent() -> Iterator[None]:
    """End the warm parent and all that it has forked, where a test used it."""
    yield
    if warm.cache_info().currsize:
        warm().close()


@pytest.fixture(scope="session", name="warm")
def warm_parent() -> Warm:
    """The process from which tests fork servers and workers; one for each process of pytest."""
    return warm()


@pytest.fixture(scope="session")
def mocap() -> Path:
    """Real capture: one folder of BVH files per verb. It is not part of the repository."""
    folder = PROJECT / os.environ.get("ADVERB_TEST_DATA", "../shared/data") / "mocap"
    if not folder.is_dir():
        pytest.skip(f"no motion capture at {folder}; point ADVERB_TEST_DATA at a folder that holds mocap/")
    return folder


@pytest.fixture(scope="session")
def verb_of(mocap: Path) -> Callable[[str], Verb]:
    """Builds the verb of a folder of captures, once per session."""
    return lru_cache(maxsize=None)(lambda name: build(mocap / name).verb)
