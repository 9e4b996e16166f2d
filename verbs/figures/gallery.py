"""Gallery: strips of verbs as PNG files, and one HTML page that shows them.

Source: Rose, Sloan, Cohen 2001, figures 15 to 18.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from verbs.domain import describe
from verbs.errors import VerbError
from verbs.figures import canvas
from verbs.figures.draw import draw_cells
from verbs.figures.strips import Strip, stands, strips, view_of
from verbs.figures.study import Progress
from verbs.units import quantity
from verbs.verb import Verb

__all__ = ["gallery"]


def gallery(
    verbs: Sequence[Verb],
    out: Path,
    *,
    sources: Sequence[str] = (),
    command: str = "adverb gallery",
    progress: Progress | None = None,
) -> list[Path]:
    """Write the strips of some verbs, and a page.

    Parameters
    ----------
    verbs : sequence of Verb
    out : Path
        Folder; made where it does not exist.
    sources : sequence of str
        What the command line calls each verb; its name unless given.
    command : str
        Command that draws the strips of a verb whose source follows.
    progress : callable, optional
        Called with (stage, done, total).

    Returns
    -------
    paths : list of Path
        The files written, ``index.html`` last.

    Raises
    ------
    VerbError
        If matplotlib is missing, or the folder cannot be made.
    """
    canvas.require()
    report = progress or (lambda stage, done, total: None)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise VerbError(f"cannot write to {out}: {err.strerror}") from err
    paths: list[Path] = []
    sections = []
    for verb, stem, source in zip(verbs, _stems(verbs), sources or [verb.name for verb in verbs], strict=True):
        found = strips(verb)
        figures = []
        for k, strip in enumerate(found):
            report(verb.name, k, len(found))
            path = _draw(verb, strip, out / f"{stem}_{_safe(strip.name)}.png")
            paths.append(path)
            figures.append(_figure(verb, strip, path))
        report(verb.name, len(found), len(found))
        sections.append(_section(verb, stem, f"{command} {shlex.quote(source)}", figures))
    page = out / "index.html"
    links = " ".join(
        f'<a href="#{stem}">{escape(verb.name)}</a>' for verb, stem in zip(verbs, _stems(verbs), strict=True)
    )
    page.write_text(_PAGE.format(style=_STYLE, links=links, sections="\n".join(sections)), encoding="utf-8")
    return [*paths, page]


def _stems(verbs: Sequence[Verb]) -> list[str]:
    """Beginnings of file names: names of verbs, numbered where two have one name."""
    names = [verb.name for verb in verbs]
    return [name if names.count(name) == 1 else f"{name}-{names[: k + 1].count(name)}" for k, name in enumerate(names)]


def _safe(name: str) -> str:
    return re.sub(r"[^\w-]+", "_", name)


def _draw(verb: Verb, strip: Strip, path: Path) -> Path:
    draw_cells(
        verb.skeleton,
        strip.cells,
        path,
        view=view_of(verb),
        columns=strip.columns,
        heads=strip.heads,
        sides=strip.sides,
        ground=stands(np.array([cell.points for cell in strip.cells])),
    )
    return path


def _section(verb: Verb, stem: str, command: str, figures: list[str]) -> str:
    """HTML of a verb: what it is, its adverbs, its error, and its strips."""
    rows = "".join(
        f"<tr><th>{escape(one.name)}</th><td>{_number(one.minimum)} to {_number(one.maximum)} {escape(one.unit)}</td>"
        f"<td>{escape(one.description)}{' (style)' if one.style else ''}</td></tr>"
        for one in verb.adverbs
    )
    return (
        f'<section id="{stem}"><h2>{escape(verb.name)}</h2>'
        + (f"<p>{escape(verb.description)}</p>" if verb.description else "")
        + f'<div class="wide"><table><tr><th>adverb</th><th>range</th><th>meaning</th></tr>{rows}</table></div>'
        f"<p>{_facts(verb)}</p><p>Drawn by <code>{escape(command)}</code>.</p>"
        f"<details><summary>{len(verb.examples)} examples</summary>"
        f"<p>{escape(', '.join(verb.examples))}</p></details>" + "".join(figures) + "</section>"
    )


def _facts(verb: Verb) -> str:
    low, high = verb.keytimes[:, -1].min(), verb.keytimes[:, -1].max()
    text = f"Domain: {describe(verb)}. Motions of {low:.2f} to {high:.2f} s{', looping' if verb.looping else ''}."
    found = verb.quality.get("methods", {}).get("corrected")
    if found is None or not verb.measure.kind:
        return escape(text)
    unit = verb.measure.unit
    mean, worst = quantity(found["error_mean_m"], unit), quantity(found["error_max_m"], unit)
    count = verb.quality.get("samples")
    points = f" at {count} random points" if count else ""
    return escape(f"{text} Measured error of the method corrected{points}: {mean} mean, {worst} max.")


def _figure(verb: Verb, strip: Strip, path: Path) -> str:
    from PIL import Image

    with Image.open(path) as picture:
        width, height = picture.size
    caption = strip.caption
    if not math.isnan(strip.error):
        caption += f" Largest error of the poses inside the domain: {quantity(strip.error, verb.measure.unit)}."
    words = f"{verb.name}: {strip.title}"
    return (
        f"<h3>{escape(strip.title)}</h3><figure>"
        f'<div class="wide"><img src="{path.name}" width="{width}" height="{height}" loading="lazy" '
        f'alt="{escape(words)}"/></div><figcaption>{escape(caption.strip())}</figcaption></figure>'
    )


def _number(value: float) -> str:
    return f"{value:.3g}".replace("-", "−")


_STYLE = """
:root { color-scheme: light dark; --paper: #fbf9f4; --ink: #2f333a; --pale: #6f7684; --line: #ddd8cb; --link: #2f6690; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #17191d; --ink: #e4e2dc; --pale: #a3a8b3; --line: #34383f; --link: #8fbfe0; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 84rem; background: var(--paper); color: var(--ink);
  font: 1rem/1.5 system-ui, sans-serif; }
h1 { font-size: 1.5rem; margin: .5rem 0; } h2 { font-size: 1.3rem; margin: 0 0 .3rem; }
h3 { font-size: 1rem; margin: 1.6rem 0 .4rem; } p { max-width: 46rem; margin: .4rem 0; }
section { border-top: 1px solid var(--line); margin-top: 2rem; padding-top: 1.5rem; }
nav a { display: inline-block; padding: .3rem .8rem .3rem 0; } a { color: var(--link); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: .6rem 0; } th, td { text-align: left; padding: .2rem 1rem .2rem 0;
  vertical-align: top; } td:nth-child(2) { white-space: nowrap; }
code { font-size: .95em; overflow-wrap: anywhere; } summary { cursor: pointer; padding: .3rem 0; }
figure { margin: 0; } img { display: block; height: auto; min-width: 56rem; max-width: 100%; border-radius: 8px; }
figcaption { color: var(--pale); font-size: .9rem; margin-top: .3rem; max-width: 46rem; }
"""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8"/>
<meta name="viewport" content="width=device-width, initial-scale=1"/>
<title>Verbs over their adverbs</title>
<style>{style}</style>
</head>
<body>
<h1>Verbs over their adverbs</h1>
<p>Each strip shows one verb: through time, along each adverb with the others in the middle of the domain, and over two
adverbs at once.</p>
<nav>{links}</nav>
{sections}
</body>
</html>
"""
