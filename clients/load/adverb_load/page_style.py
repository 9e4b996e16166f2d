"""The frame of a page: one file, no scripts, no network, light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

__all__ = ["document", "table"]

STYLE = """
:root{color-scheme:light dark;--bg:#f7f8fa;--card:#fff;--text:#1c2230;--dim:#667085;--line:#e2e6ee;
--c1:#2563eb;--c2:#d97706;--c3:#dc2626;--c4:#0f8f6e;--good:#0f8f6e;--bad:#c62828;--warn:#a15c00}
@media(prefers-color-scheme:dark){:root{--bg:#12151c;--card:#1a1f29;--text:#e6e9f0;--dim:#98a2b8;--line:#2c3342;
--c1:#7aa7ff;--c2:#f3b052;--c3:#ff8274;--c4:#4fd1a5;--good:#4fd1a5;--bad:#ff8274;--warn:#f3b052}}
*{box-sizing:border-box}body{margin:0;background:var(--bg);color:var(--text);font:14px/1.45 system-ui,sans-serif}
main{max-width:1180px;margin:0 auto;padding:28px 20px 60px}h1{font-size:24px;margin:0 0 4px}
h2{font-size:18px;margin:34px 0 4px}h3{font-size:13px;margin:0 0 6px;color:var(--dim);font-weight:600}
.sub{color:var(--dim);margin:0 0 14px}.tiles{display:grid;
grid-template-columns:repeat(auto-fill,minmax(170px,1fr));gap:10px}
.tile,.card{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:12px 14px;min-width:0}
.tile b{display:block;font-size:20px;font-variant-numeric:tabular-nums}.tile span{color:var(--dim);font-size:12px}
.plots{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,440px),1fr));gap:12px;margin:12px 0}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}.scroll{overflow-x:auto}
th,td{padding:5px 10px;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th:first-child,td:first-child{text-align:left;padding-left:0}th{color:var(--dim);font-weight:600;font-size:12px}
tr:last-child td{border-bottom:0}.note{margin:8px 0;padding:9px 12px;border-radius:8px;border:1px solid var(--line)}
.note.bad{border-color:var(--bad);color:var(--bad)}.note.warn{border-color:var(--warn);color:var(--warn)}
.good{color:var(--good)}.bad{color:var(--bad)}.none{color:var(--dim);padding:30px;text-align:center}
.legend{display:flex;flex-wrap:wrap;gap:4px 14px;font-size:12px;color:var(--dim);margin-top:4px}
.legend i{display:inline-block;width:16px;height:0;border-top:2.5px solid;margin-right:5px;vertical-align:3px}
.legend i.dash{border-top-style:dashed}
i.l1{border-color:var(--c1)}i.l2{border-color:var(--c2)}i.l3{border-color:var(--c3)}i.l4{border-color:var(--c4)}
svg{display:block;width:100%;height:auto}svg text{fill:var(--dim);font:11px system-ui,sans-serif}
path{fill:none;stroke-width:1.8;stroke-linejoin:round}.dash{stroke-dasharray:5 4}
path.l1{stroke:var(--c1)}path.l2{stroke:var(--c2)}path.l3{stroke:var(--c3)}path.l4{stroke:var(--c4)}
path.f1{fill:var(--c1);opacity:.13}path.f2{fill:var(--c2);opacity:.13}path.f3{fill:var(--c3);opacity:.13}path.f4{fill:var(--c4);opacity:.13}
.p1{fill:var(--c1)}.p2{fill:var(--c2)}.p3{fill:var(--c3)}.p4{fill:var(--c4)}
.grid{stroke:var(--line)}.tick{stroke:var(--dim)}rect.b{rx:3}
"""


def document(title: str, body: Sequence[str]) -> str:
    """A whole page."""
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    main = "".join(body)
    start = f"<!doctype html><html lang=en><head>{head}<style>{STYLE}</style></head>"
    return f"{start}<body><main>{main}</main></body></html>\n"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; cells are HTML."""
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{lines}</tbody></table></div>'
