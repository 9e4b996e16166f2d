"""The TypeScript client has the error codes of the Python client, in the same families."""

from __future__ import annotations

import re

import pytest
from adverb_client import errors

from tests.clients.typescript.node import PACKAGE

SOURCE = (PACKAGE / "src" / "errors.ts").read_text("utf-8")
TABLE = SOURCE[SOURCE.index("const CLASSES") : SOURCE.index("const BY_CODE")]
FAMILIES = ("NoAccess", "UnknownName", "BadRequest", "Conflict", "TooLarge", "Unavailable", "ChannelError")


def codes_of(family):
    kinds = [family, *family.__subclasses__()]
    return {kind.code for kind in kinds if "code" in vars(kind)}


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_has_the_same_codes(name):
    row = re.search(rf"\b{name},(.*?)(?=\b(?:{'|'.join(FAMILIES)}),|\Z)", TABLE, re.DOTALL)
    assert row is not None
    assert set(re.findall(r'"([a-z_]+)"', row.group(1))) == codes_of(getattr(errors, name))
