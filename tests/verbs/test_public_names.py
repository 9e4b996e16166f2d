"""The public names of the library: what is listed is importable, and nothing else is."""

import subprocess
import sys

import pytest

import verbs


def test_listed_names_are_those_that_can_be_imported():
    assert dir(verbs) == sorted(verbs.__all__) == sorted(verbs._MODULE_OF)
    for name in verbs.__all__:
        assert getattr(verbs, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        verbs.Nothing  # noqa: B018


def test_a_star_import_gives_the_listed_names():
    code = "from verbs import *; print(sorted(name for name in dir() if name[0] != '_'))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.strip() == str(sorted(verbs.__all__))


def test_every_public_name_is_documented():
    for name in verbs.__all__:
        text = getattr(verbs, name).__doc__
        assert text, name
        assert not text.startswith(f"{name}("), f"{name} has the generated docstring of a dataclass"
        assert f"`{name}`" in verbs.__doc__, f"{name} is missing from the module's docstring"


def test_importing_the_library_imports_no_heavy_package():
    code = "import sys, verbs; print({'numpy', 'numba', 'scipy'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"
