"""Which scope a request needs, by its method and path.

Each rule names a method, a pattern of the path and the scope; the first that fits counts. What no rule names needs
``admin``, so that a new route is closed until it has a rule.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

__all__ = ["ANY", "DOCS", "METRICS", "OPEN", "RULES", "Rule", "needed"]

OPEN = "open"
"""No key is needed: liveness, readiness, and the page's own files."""

ANY = "any"
"""Any valid key: descriptions of verbs, drafts, versions and refinements."""

DOCS, METRICS = "docs", "metrics"
"""Any valid key, or none where ``ADVERB_OPEN_DOCS`` or ``ADVERB_OPEN_METRICS`` is set."""

_READING = ("GET", "HEAD")


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule: methods (all if empty), a pattern that the whole path must match, and what is needed."""

    methods: tuple[str, ...]
    path: re.Pattern[str]
    scope: str

    def fits(self, method: str, path: str) -> bool:
        """Whether the rule is about a request."""
        return (not self.methods or method in self.methods) and self.path.fullmatch(path) is not None


def _rule(methods: tuple[str, ...], path: str, scope: str) -> Rule:
    return Rule(methods, re.compile(path), scope)


RULES = (
    _rule(("POST",), r"/v1/verbs/[^/]+/(pose|poses|sequence)", "pose"),
    _rule(_READING, r"/v1/stream", "pose"),
    _rule(_READING, r"/v1/verbs/[^/]+/(quality|artifact|versions/[^/]+)", "pose"),
    _rule(_READING, r"/v1/verbs(/[^/]+(/versions)?)?", ANY),
    _rule(("POST",), r"/v1/verbs", "author"),
    _rule(("DELETE",), r"/v1/verbs/[^/]+", "author"),
    _rule(("POST",), r"/v1/verbs/[^/]+/(examples|versions/[^/]+/activate)", "author"),
    _rule((), r"/v1/drafts(/.*)?", "author"),
    _rule(("POST",), r"/v1/verbs/[^/]+/refinements", "refine"),
    _rule(_READING, r"/v1/refinements(/[^/]+(/events)?)?", ANY),
    _rule(("DELETE",), r"/v1/refinements/[^/]+", "refine"),
    _rule(_READING, r"/v1/audit", "admin"),
    _rule(_READING, r"/v1/access", ANY),
    _rule(_READING, r"/|/assets/.*|/livez|/readyz|/v2/health/(live|ready)", OPEN),
    _rule(_READING, r"/docs|/openapi\.json", DOCS),
    _rule(_READING, r"/metrics", METRICS),
)


@lru_cache(maxsize=1024)
def needed(method: str, path: str) -> str:
    """Scope that a request needs, or :data:`OPEN`, :data:`ANY`, :data:`DOCS` or :data:`METRICS`."""
    return next((rule.scope for rule in RULES if rule.fits(method, path)), "admin")
