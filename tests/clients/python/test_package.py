"""Public names and imports of the package."""

import ast
import types
from pathlib import Path

import adverb_client

SOURCES = sorted(Path(adverb_client.__file__).parent.glob("*.py"))


def test_all_lists_the_public_names():
    shown = {
        name
        for name, value in vars(adverb_client).items()
        if not name.startswith("_") and not isinstance(value, types.ModuleType)
    }
    assert shown | {"errors"} == set(adverb_client.__all__)
    assert list(adverb_client.__all__) == sorted(adverb_client.__all__)


def test_every_error_is_in_the_documented_tree():
    tree = adverb_client.errors.__doc__
    for name in adverb_client.errors.__all__:
        assert name in tree or name in ("FieldError", "error_class")


def test_it_imports_nothing_of_the_server():
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [row.name for row in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.split(".")[0] for name in names} & {"verbs", "service"}, path.name
