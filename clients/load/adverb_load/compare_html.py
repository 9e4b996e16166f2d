"""A comparison of two reports as one page."""

from __future__ import annotations

from html import escape

from adverb_load.compare import Comparison, Difference
from adverb_load.page_style import document, table

__all__ = ["comparison_page"]

WIDTH, HEIGHT = 260.0, 22.0


def comparison_page(found: Comparison) -> str:
    """The comparison as HTML: a table for each group, with the bounds of every change drawn."""
    body = ["<h1>Comparison of two loads</h1>",
            '<p class="sub">Changes from A to B; positive is worse. Bars are the bounds of 95 % of resamples of the '
            "intervals: a bar across 0 is noise.</p>"]  # fmt: skip
    body += [
        f'<p class="note bad">{escape(row.group)}: {escape(row.figure)} is worse by {row.change:.1f} %</p>'
        for row in found.failed
    ]
    body += [f'<p class="note warn">{escape(text)}</p>' for text in found.remarks]
    body += [f'<p class="note warn">only one report has {escape(name)}</p>' for name in found.missing]
    widest = max((max(abs(row.low), abs(row.high), abs(row.change)) for row in found.differences), default=1.0)
    widest = min(max(widest, 5.0), 200.0)
    for group in dict.fromkeys(row.group for row in found.differences):
        rows = [_row(row, widest) for row in found.differences if row.group == group]
        body += [
            f"<h2>{escape(group)}</h2>",
            f'<div class="card">{table(["", "A", "B", "change", "", ""], rows)}</div>',
        ]
    return document("Adverb load: comparison", body)


def _row(row: Difference, widest: float) -> list[str]:
    unit = f", {row.unit}" if row.unit else ""
    kind = {"worse": "bad", "better": "good"}.get(row.verdict, "")
    change = f'<span class="{kind}">{row.change:+.1f} %</span>'
    return [escape(row.figure + unit), f"{row.before:.4g}", f"{row.after:.4g}", change, _bar(row, widest), row.verdict]


def _bar(row: Difference, widest: float) -> str:
    def place(value: float) -> float:
        return 0.5 * WIDTH * (1.0 + min(max(value / widest, -1.0), 1.0))

    low, high, middle = place(row.low), place(row.high), place(row.change)
    colour = {"worse": "--c3", "better": "--c4"}.get(row.verdict, "--dim")
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {HEIGHT:g}" style="width:{WIDTH:g}px;display:inline-block;vertical-align:middle">'
        f'<line class="tick" x1="{WIDTH / 2:g}" x2="{WIDTH / 2:g}" y1="2" y2="{HEIGHT - 2:g}"/>'
        f'<rect x="{low:.1f}" y="7" width="{max(high - low, 2.0):.1f}" height="8" rx="3" '
        f'style="fill:var({colour});opacity:.45"/>'
        f'<circle cx="{middle:.1f}" cy="11" r="3.5" style="fill:var({colour})"/></svg>'
    )
