"""Settings of commands, from options and the environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer
from pydantic import ValidationError

from service.settings import Settings

__all__ = ["DEFAULT_DATA", "USER_ERROR", "settings_of"]

USER_ERROR = 1
"""Exit code of a mistake of the user."""

DEFAULT_DATA = Path("data")
"""Data folder where none is given."""


def settings_of(**options: Any) -> Settings:
    """Settings from the given options; exits with a message for each wrong one."""
    try:
        return Settings(**{name: value for name, value in options.items() if value is not None})
    except ValidationError as err:
        for row in err.errors():
            field = str(row["loc"][0]) if row["loc"] else "settings"
            typer.echo(f"error: ADVERB_{field.upper()} (--{field.replace('_', '-')}): {row['msg']}", err=True)
        raise typer.Exit(USER_ERROR) from err
