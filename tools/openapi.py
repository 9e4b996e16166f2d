"""Write the OpenAPI document of the service: ``python -m tools.openapi``."""

from __future__ import annotations

import json
from pathlib import Path

from service.app import create_app
from service.settings import Settings

__all__ = ["FILE", "text"]

FILE = Path(__file__).parents[1] / "docs" / "openapi.json"


def text() -> str:
    """The document as it is committed: keys sorted, and the same for the same code."""
    return json.dumps(create_app(Settings()).openapi(), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
