"""Field types that request bodies and stream messages share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

__all__ = ["STRICT", "MapGoal", "Name", "Space"]

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)
"""Reject unknown fields, conversions and numbers that are not finite."""

Name = Annotated[str, Field(min_length=1, max_length=200)]
Space = Literal["local", "global"]
MapGoal = Literal["scaled", "world"]
