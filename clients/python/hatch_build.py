"""Build hook: packages the load tester, which needs the client and nothing of the server, with the client."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NAME = "adverb_load"


class LoadTester(BuildHookInterface):  # type: ignore[misc,type-arg]
    """Adds ``clients/load/adverb_load`` to wheels and source archives; editable installs find it in its folder."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the package: from beside this folder, or from this folder in an unpacked source archive."""
        root = Path(self.root)
        places = [place for place in (root.parent / "load" / NAME, root / NAME) if place.is_dir()]
        if version == "standard" and places:
            build_data["force_include"][str(places[0])] = NAME
