"""Quality route: maps of error, smoothness and support."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import numpy as np
import orjson
from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from service.fields import Name
from service.http.context import served, trace_of
from service.http.documented import READING, VerbName, problems
from service.http.negotiation import JSON
from service.http.response_models import QualityAnswer
from verbs.conventions import F64
from verbs.errors import RequestError
from verbs.quality import quality_map
from verbs.runtime import describe

__all__ = ["router"]

router = APIRouter(prefix="/v1/verbs", tags=["verbs"])

NODE_US = 40.0
"""Estimated time per node; ten times as much by inverse blending. Maps are computed in a thread."""

_AT = Query(max_length=2_000, description="Adverbs that are held, `name=value,…`; the others are at mid-range.")


@router.get(
    "/{verb}/quality",
    operation_id="quality",
    response_model=QualityAnswer,
    responses=problems(*READING, "unknown_version", "invalid_request", "overloaded"),
    summary="Maps of error, smoothness and support",
)
async def quality(
    request: Request,
    verb: VerbName,
    method: Annotated[Name | None, Query(description="One of the verb's `methods`; its own by default.")] = None,
    across: Annotated[Name | None, Query(description="Adverb from left to right.")] = None,
    up: Annotated[Name | None, Query(description="Adverb from below to above.")] = None,
    at: Annotated[str, _AT] = "",
    nodes: Annotated[int, Query(ge=3, le=quality_map.MOST_NODES, description="Nodes to a side.")] = 41,
    version: Annotated[int | None, Query(ge=1, description="A version; the current one by default.")] = None,
) -> Response:
    """Map a method over a plane of adverbs: its error, the curvature κ of its weights, and support by the examples.

    Nodes outside the domain are null. κ scales with the square of the spacing: compare maps of one grid only.
    """
    state, entry = served(request, verb)
    entry = await state.version(entry, version)
    entry.check(method=method)
    held = _held(at)
    work = partial(quality_map.over, entry.evaluator, method=method, across=across, up=up, held=held, nodes=nodes)
    found = await state.pool.run(NODE_US * nodes * nodes, work)
    trace_of(request).method = found.method
    head = {
        "verb": entry.verb.name,
        "version": entry.version,
        "method": found.method,
        "unit": entry.verb.measure.unit,
        "across": found.across,
        "up": found.up,
        "held": found.held,
        "columns": found.columns.tolist(),
        "rows": found.rows.tolist(),
    }
    for name, values in (("error", found.error), ("smoothness", found.smoothness)):
        head |= {name: _table(values), f"{name}_mean": _of(values, np.mean), f"{name}_max": _of(values, np.max)}
    head |= {"support": _table(found.support), "support_mean": _of(found.support, np.mean)}
    head["support_min"] = _of(found.support, np.min)
    return Response(orjson.dumps(head), media_type=JSON)


def _held(text: str) -> dict[str, float]:
    """Adverbs of ``name=value,…``; raises :class:`RequestError` for any other text."""
    held = {}
    for part in filter(None, text.split(",")):
        name, _, value = part.partition("=")
        try:
            held[name.strip()] = float(value)
        except ValueError:
            raise RequestError(f"'at' must be name=value, …; '{part[:100]}' is not") from None
    return held


def _table(values: F64) -> list[list[float | None]]:
    return [describe.numbers(row) for row in values]


def _of(values: F64, figure: object) -> float | None:
    """A statistic of the finite values; None if there are none."""
    found = values[np.isfinite(values)]
    return float(figure(found)) if len(found) else None  # type: ignore[operator]
