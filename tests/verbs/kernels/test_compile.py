"""The kernel cache: what compiles again after an edit, and the private parts of Numba that it uses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numba.core import caching, types
from numba.core.dispatcher import Dispatcher

from verbs.kernels import compile as compiling
from verbs.kernels.compile import digest, direct, entry_point, kernel

HELPERS = """
from typing import NamedTuple
from verbs.kernels.compile import kernel

class Pair(NamedTuple):
    first: int
    second: int

SCALE = 3.0
UNUSED = 1.0

@kernel
def scaled(x):
    return SCALE * x

@kernel
def unrelated(x):
    return x - 1.0
"""

CALLERS = """
from chosen import helpers
from chosen.helpers import scaled
from verbs.kernels.compile import kernel

@kernel
def by_attribute(x):
    return helpers.scaled(x) + 1.0

@kernel
def by_name(x):
    return later(x) + 2.0

@kernel
def later(x):
    return scaled(x)

@kernel
def difference(pair):
    return pair.first - 10 * pair.second
"""

CALL = """
import json
from chosen import callers, helpers
pair = helpers.Pair(second=2, first=1)
results, misses = {}, []
for kernel, argument in (
    (callers.by_attribute, 2.0), (callers.by_name, 2.0), (callers.difference, pair), (helpers.unrelated, 2.0)
):
    name = kernel.py_func.__name__
    results[name] = kernel(argument)
    if kernel.stats.cache_misses:
        misses.append(name)
print(json.dumps([results, sorted(misses)]))
"""

ALL = ["by_attribute", "by_name", "difference", "unrelated"]
CALLING = ["by_attribute", "by_name"]


class Package:
    """A package of two files, whose kernels are called in a process of its own."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self.folder, self.environment = folder / "chosen", environment
        self.folder.mkdir()
        (self.folder / "__init__.py").touch()
        self.write("helpers.py", HELPERS)
        self.write("callers.py", CALLERS)

    def write(self, name: str, source: str) -> None:
        """Write a file with one and the same modification time: the cache must not depend on it."""
        (self.folder / name).write_text(source)
        os.utime(self.folder / name, (1_700_000_000, 1_700_000_000 + len(source)))

    def call(self) -> tuple[dict[str, float], list[str]]:
        """Results of all kernels, and the names of those that were compiled rather than loaded."""
        paths = os.pathsep.join([str(self.folder.parent), str(Path(compiling.__file__).parents[2])])
        reply = subprocess.run(
            [sys.executable, "-B", "-W", "error", "-c", CALL],
            env=self.environment | {"PYTHONPATH": paths},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )
        assert reply.returncode == 0, reply.stderr
        results, misses = json.loads(reply.stdout)
        return results, misses


@pytest.fixture(params=["set", "unset"])
def package(request: pytest.FixtureRequest, tmp_path: Path) -> Package:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    if request.param == "set":
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    return Package(tmp_path, environment)


def test_an_edit_compiles_the_kernels_that_use_it_and_no_other(package):
    first = {"by_attribute": 7.0, "by_name": 8.0, "difference": -19, "unrelated": 1.0}
    assert package.call() == (first, ALL)
    assert package.call() == (first, [])

    package.write("helpers.py", "# a comment moves every line\n" + HELPERS.replace("UNUSED = 1.0", "UNUSED = 2.0"))
    assert package.call() == (first, [])

    package.write("helpers.py", HELPERS.replace("SCALE * x", "SCALE * x * x"))
    assert package.call() == (first | {"by_attribute": 13.0, "by_name": 14.0}, CALLING)

    package.write("helpers.py", HELPERS.replace("SCALE = 3.0", "SCALE = 5.0"))
    assert package.call() == (first | {"by_attribute": 11.0, "by_name": 12.0}, CALLING)

    package.write("helpers.py", HELPERS.replace("first: int\n    second: int", "second: int\n    first: int"))
    assert package.call() == (first, ["difference"])

    package.write("helpers.py", HELPERS)
    assert package.call() == (first, [])  # code of an earlier state is still there


def test_a_source_tree_that_cannot_be_written_to_uses_the_folder_of_the_user(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    package = Package(tmp_path, environment | {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")})
    (package.folder / "__pycache__").touch()  # a file where the folder would be: denied to every user, root too
    assert package.call()[1] == ALL
    assert package.call()[1] == []
    assert list(home.rglob("*.nbc"))


def test_without_a_writable_folder_kernels_are_compiled_with_a_warning(monkeypatch):
    monkeypatch.setattr(compiling._Implementation, "_locator_classes", [])

    @kernel
    def doubled(x):
        return 2.0 * x

    with pytest.warns(RuntimeWarning, match="NUMBA_CACHE_DIR"):
        assert doubled(2.0) == 4.0


SETTINGS: list[float] = [1.0]


def test_what_could_change_unseen_is_refused():
    @kernel
    def careless(x):
        return x * SETTINGS[0]

    with pytest.raises(TypeError, match="careless: 'SETTINGS' is a list"):
        digest(careless.py_func)


class Bundle(NamedTuple):
    values: np.ndarray
    factor: float


@kernel
def product(bundle, out):
    out[0] = bundle.values[0] * bundle.factor


def test_the_entry_point_gives_what_the_kernel_gives():
    """Fails when Numba's ``Dispatcher.compile`` no longer returns the compiled function."""
    bundle, out, written = Bundle(np.array([3.0]), 2.0), np.zeros(1), np.zeros(1)
    entry = entry_point(product, bundle, written)
    assert entry is product.overloads[next(iter(product.overloads))].entry_point
    assert entry(bundle, written) is None
    product(bundle, out)
    assert written[0] == out[0] == 6.0
    call = direct(product)
    call(bundle, written)
    call(Bundle(np.array([4.0]), 2.0), written)
    assert written[0] == 8.0
    assert len(product.overloads) == 1  # all ways run the same code


def test_the_private_parts_of_numba_are_where_they_were():
    assert isinstance(product, Dispatcher)
    assert isinstance(product._cache, compiling._LazyCache)
    assert isinstance(product._cache._opened, compiling._KernelCache)
    assert issubclass(compiling._KernelCache, caching._Cache)
    assert caching.CompileResultCacheImpl._locator_classes[:3] == [
        caching.UserProvidedCacheLocator, caching.InTreeCacheLocator, caching.UserWideCacheLocator,
    ]  # fmt: skip
    files = product._cache._opened._cache_file
    assert files._source_stamp == digest(product.py_func)
    assert digest(product.py_func)[:16] in files._index_name
    pair = types.NamedTuple((types.float64, types.float64), Bundle)
    assert compiling._bundles((pair, types.int64)) == ((), ((Bundle.__qualname__, "values", "factor"),))
