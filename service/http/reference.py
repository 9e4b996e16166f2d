"""HTML of the reference and of the list of verbs, self-contained so that both work offline."""

from __future__ import annotations

import json
from html import escape
from typing import Any

from service.catalog.catalog import Catalog
from service.errors import PROBLEMS

__all__ = ["CONTENT_POLICY", "DASHBOARD_POLICY", "reference", "welcome"]

CONTENT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
"""Content security policy of these pages, without ``frame-ancestors``: they load nothing."""

DASHBOARD_POLICY = (
    "default-src 'self'; script-src 'self'; worker-src 'self'; connect-src 'self' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; base-uri 'none'; form-action 'none'"
)
"""Content security policy of the dashboard, without ``frame-ancestors``: own files, own server, inline styles.

Textures of a figure that the user drops are read as ``blob:``.
"""

_STYLE = """
:root{color-scheme:light dark;--line:#8884;--soft:#8882;--key:#2f6fde}
@media(prefers-color-scheme:dark){:root{--key:#7fb0ff}}
body{font:16px/1.5 system-ui,sans-serif;max-width:58rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.9rem;margin:0}h2{margin:2.5rem 0 .5rem}h3{margin:2rem 0 .3rem;font-size:1.1rem}
a{color:var(--key)}code,pre{font:.86em/1.45 ui-monospace,monospace}
pre{background:var(--soft);padding:.7rem .9rem;border-radius:6px;overflow-x:auto}
table{border-collapse:collapse;width:100%;margin:.5rem 0}
th,td{text-align:left;vertical-align:top;padding:.35rem .8rem .35rem 0;border-bottom:1px solid var(--line)}
.method{font:600 .8em ui-monospace,monospace;background:var(--key);color:#fff;border-radius:4px;padding:.15em .5em}
@media(prefers-color-scheme:dark){.method{color:#111}}
.quiet{opacity:.75}summary{cursor:pointer}
"""


def welcome(catalog: Catalog | None) -> str:
    """Page that lists the verbs, for a server without the dashboard."""
    if catalog is None:
        return _page("Adverb", "<h1>Adverb</h1><p>Verbs are being loaded; reload in a moment.</p>")
    rows = "".join(
        f"<tr><td><a href='/v1/verbs/{escape(name)}'>{escape(name)}</a></td><td>{entry.version}</td>"
        f"<td>{', '.join(escape(adverb.name) for adverb in entry.verb.adverbs)}</td>"
        f"<td>{escape(entry.verb.description)}</td></tr>"
        for name, entry in catalog.entries.items()
    )
    table = f"<table><tr><th>verb<th>version<th>adverbs<th>meaning</tr>{rows}</table>" if rows else "<p>None yet.</p>"
    broken = "".join(f"<li><code>{escape(row.file)}</code>: {escape(row.problem)}</li>" for row in catalog.skipped)
    return _page(
        "Adverb",
        "<h1>Adverb</h1><p>Example motions in, any motion in between out, with its measured error.</p>"
        f"<h2>Verbs</h2>{table}"
        + (f"<h2>Files that are not served</h2><ul>{broken}</ul>" if broken else "")
        + "<h2>More</h2><ul><li><a href='/docs'>Reference</a></li><li><a href='/v1/verbs'>Verbs as JSON</a></li>"
        "<li><a href='/metrics'>Metrics</a></li><li><a href='/openapi.json'>OpenAPI document</a></li></ul>"
        "<p class='quiet'>The dashboard is not built; where npm is, <code>make dashboard</code> builds it.</p>",
    )


def reference(document: dict[str, Any]) -> str:
    """Page with all routes, their parameters, bodies and responses, then schemas and problems."""
    schemas = document["components"]["schemas"]
    routes = [
        _route(path, method, operation, schemas)
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
    ]
    return _page(
        "Adverb: reference",
        f"<p><a href='/'>Adverb</a></p><h1>Reference</h1><p>{_inline(document['info']['description'])} "
        "Machines read <a href='/openapi.json'>openapi.json</a>.</p>"
        f"<h2>Routes</h2>{''.join(routes)}<h2>Schemas</h2>{''.join(_schema(*item) for item in sorted(schemas.items()))}"
        f"<h2>Problems</h2>{_problems()}",
    )


def _page(title: str, content: str) -> str:
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width,initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>{content}</body></html>"
    )


def _inline(text: str) -> str:
    """Text as HTML, with backquotes as code."""
    parts = escape(text).split("`")
    return "".join(f"<code>{part}</code>" if k % 2 else part for k, part in enumerate(parts)).replace("\n\n", "<p>")


def _route(path: str, method: str, operation: dict[str, Any], schemas: dict[str, Any]) -> str:
    head = (
        f"<h3 id='{escape(operation['operationId'])}'><span class='method'>{method.upper()}</span> "
        f"<code>{escape(path)}</code> <span class='quiet'>{escape(operation.get('summary', ''))}</span></h3>"
    )
    parts = [head, f"<p>{_inline(operation.get('description', ''))}</p>"]
    parameters = operation.get("parameters", [])
    if parameters:
        rows = "".join(
            f"<tr><td>{escape(row['name'])}</td><td>{row['in']}{', required' * row.get('required', 0)}</td>"
            f"<td>{_type(row['schema'])}</td><td>{_inline(row.get('description', ''))}</td></tr>"
            for row in parameters
        )
        parts.append(f"<table><tr><th>parameter<th>in<th>type<th></tr>{rows}</table>")
    parts.append(_contents("body", operation.get("requestBody", {}).get("content", {})))
    for status, response in operation["responses"].items():
        parts.append(_contents(status, response.get("content", {}), response.get("description", "")))
    parts.append(f"<pre>{escape(_curl(path, method, operation, schemas))}</pre>")
    return "".join(parts)


def _contents(label: str, content: dict[str, Any], note: str = "") -> str:
    if not content:
        return f"<div>{label}: {_inline(note)}</div>" if note else ""
    kinds = ", ".join(f"<code>{escape(kind)}</code> {_type(row.get('schema', {}))}" for kind, row in content.items())
    return f"<div>{label}: {kinds} <span class='quiet'>{_inline(note)}</span></div>"


def _type(schema: dict[str, Any]) -> str:
    """Short HTML of a schema, with links to named schemas."""
    if "$ref" in schema:
        name = escape(schema["$ref"].rsplit("/", 1)[1])
        return f"<a href='#{name}'>{name}</a>"
    if "anyOf" in schema:
        return " or ".join(_type(option) for option in schema["anyOf"])
    if "enum" in schema:
        return " or ".join(f"<code>{escape(json.dumps(value))}</code>" for value in schema["enum"])
    if schema.get("type") == "array":
        return f"array of {_type(schema.get('items', {}))}{_bounds(schema, 'minItems', 'maxItems')}"
    if schema.get("type") == "object" and isinstance(schema.get("additionalProperties"), dict):
        return f"object of {_type(schema['additionalProperties'])}"
    return escape(str(schema.get("type", "any"))) + _bounds(schema, "minimum", "maximum")


def _bounds(schema: dict[str, Any], low: str, high: str) -> str:
    least, most = schema.get(low, schema.get("exclusiveMinimum")), schema.get(high)
    if least is None and most is None:
        return ""
    return f", {'' if least is None else least}…{'' if most is None else most}"


def _schema(name: str, schema: dict[str, Any]) -> str:
    required = set(schema.get("required", ()))
    rows = "".join(
        f"<tr><td><code>{escape(key)}</code>{' *' if key in required else ''}</td><td>{_type(row)}</td>"
        f"<td>{_inline(row.get('description', ''))}</td></tr>"
        for key, row in schema.get("properties", {}).items()
    )
    table = f"<table><tr><th>field (* required)<th>type<th></tr>{rows}</table>" if rows else ""
    return f"<h3 id='{escape(name)}'>{escape(name)}</h3><p>{_inline(schema.get('description', ''))}</p>{table}"


def _problems() -> str:
    rows = "".join(
        f"<tr id='{row.code}'><td><code>{row.code}</code></td><td>{row.status}</td><td>{escape(row.title)}</td>"
        f"<td>{_inline(row.advice)}</td></tr>"
        for row in PROBLEMS.values()
    )
    return f"<table><tr><th>code<th>status<th>title<th>what to do</tr>{rows}</table>"


def _curl(path: str, method: str, operation: dict[str, Any], schemas: dict[str, Any]) -> str:
    address = "http://127.0.0.1:8000" + path.replace("{verb}", "reach")
    content = operation.get("requestBody", {}).get("content", {}).get("application/json")
    if not content:
        return f"curl {address}"
    examples = schemas[content["schema"]["$ref"].rsplit("/", 1)[1]].get("examples", [{}])
    return f"curl -X {method.upper()} {address} -H 'Content-Type: application/json' -d '{json.dumps(examples[0])}'"
