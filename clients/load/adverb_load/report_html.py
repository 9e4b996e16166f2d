"""The report as one page with plots."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from adverb_load.histogram import Histogram
from adverb_load.page_style import document, table
from adverb_load.report_text import faults_of, milliseconds, quantity, warnings_of
from adverb_load.svg import Line, legend, plot

__all__ = ["page"]

Json = Mapping[str, Any]

NINES = ((0.0, "0"), (0.3010, "50"), (1.0, "90"), (2.0, "99"), (3.0, "99.9"))
"""Places of percentiles p on the axis: −log₁₀(1 − p/100)."""

COLUMNS = ("p50", "p90", "p95", "p99", "p99.9", "max")


def page(report: Json) -> str:
    """The report as HTML: no scripts, no network."""
    profile = report["profile"]
    began = f"{report['seconds']:g} s from {report['started']}, seed {report['seed']}, {report['server']}"
    body = [
        f"<h1>Load: {escape(profile['name'])}</h1>",
        f'<p class="sub">{escape(profile["description"])}<br>{escape(began)}</p>',
    ]
    body += [f'<p class="note bad">{escape(text)}</p>' for text in faults_of(report)]
    body += [f'<p class="note warn">{escape(text)}</p>' for text in warnings_of(report)]
    for group in report["streams"]:
        body += _streams(group, report["interval_s"])
    for group in report["requests"]:
        body += _requests(group, report["interval_s"])
    body += _client(report)
    return document(f"Adverb load: {profile['name']}", body)


def _streams(group: Json, interval_s: float) -> list[str]:
    plan, frames, poses, summary = group["plan"], group["frames"], group["poses"], group["summary"]
    what = (
        f"{plan['sockets']} sockets × {plan['channels']} channels of {', '.join(plan['verbs'])}, "
        f"{plan['fps']} fps, {plan['encoding']}"
    )
    share = 100.0 * frames["per_s"] / frames["target_per_s"]
    lost = frames["dropped"] + frames["skipped"]
    tiles = [
        (f"{share:.1f} %", f"of {frames['target_per_s']:g} frames a second"),
        (f"{lost}", "frames dropped or skipped"),
        (f"{frames['gaps']}", "missing unreported"),
    ]
    if summary["lateness_s"]["count"]:
        tiles.insert(1, (f"{milliseconds(summary['lateness_s']['p99'])} ms", "lateness of frames, p99"))
    if summary["response_s"]["count"]:
        tiles.append((f"{milliseconds(summary['response_s']['p99'])} ms", "goal to frame, p99"))
    if poses["measured"]:
        tiles.append((quantity(summary["error_m"]["max"]), f"largest error, of {poses['measured']} measured poses"))
    if frames["dropped_slow"]:
        tiles.append((f"{frames['dropped_slow']}", "dropped for slow readers"))
    rows = [(label, name) for label, name in (("lateness", "lateness_s"), ("between frames", "spacing_s"),
                                              ("goal to frame", "response_s")) if summary[name]["count"]]  # fmt: skip
    body = [
        f"<h2>{escape(group['name'])}</h2>",
        f'<p class="sub">{escape(what)}</p>',
        _tiles(tiles),
        '<div class="plots">',
    ]
    if rows:
        body.append(_over_time("Lateness of frames", group["series"]["lateness_s"], interval_s))
        body.append(_distribution("Distribution of times", [(label, group["series"][name]) for label, name in rows]))
    body.append(_rates("Frames", group["per_interval"]["frames"], frames["target_per_s"], interval_s))
    if poses["measured"]:
        body.append(_lengths("Error, measured here by forward kinematics", group["series"]["error_m"]))
    body += [
        "</div>",
        _times_table(rows, summary),
        _errors({**group["errors"], **group["opened"]["failed"]}, group["problems"]),
    ]
    return body


def _requests(group: Json, interval_s: float) -> list[str]:
    plan, counts, summary = group["plan"], group["requests"], group["summary"]
    what = plan["route"] if plan["route"] in ("verbs", "health") else f"{plan['route']} of {plan['verb']}"
    failed = sum(group["errors"].values())
    tiles = [
        (f"{counts['per_s']:g}", f"responses a second, of {counts['target_per_s']:g} requested"),
        (f"{milliseconds(summary['latency_s']['p50'])} ms", "latency from the scheduled time, p50"),
        (f"{milliseconds(summary['latency_s']['p99'])} ms", "latency, p99"),
        (f"{failed}", f"failed of {counts['scheduled']}"),
    ]
    if counts["measured"]:
        tiles.append((quantity(summary["error_m"]["max"]), f"largest error, of {counts['measured']} measured poses"))
    rows = [
        ("latency, from the scheduled time", "latency_s"),
        ("service, from sending", "service_s"),
        ("wait to be sent", "wait_s"),
    ]
    body = [f"<h2>{escape(group['name'])}</h2>",
            f'<p class="sub">{escape(what)}, {plan["accept"]}, {plan["arrivals"]} arrivals</p>',
            _tiles(tiles), '<div class="plots">',
            _over_time("Latency from the scheduled time", group["series"]["latency_s"], interval_s),
            _distribution("Distribution of times", [(label, group["series"][name]) for label, name in rows[:2]]),
            _rates("Responses", group["per_interval"]["ended"], counts["target_per_s"], interval_s)]  # fmt: skip
    if counts["measured"]:
        body.append(_lengths("Error, measured here by forward kinematics", group["series"]["error_m"]))
    return [*body, "</div>", _times_table(rows, summary), _errors(group["errors"], group["problems"])]


def _client(report: Json) -> list[str]:
    client = report["client"]
    where = f"{client['system']}, {client['cores']} cores, Python {client['python']}, {client['loop']}"
    tiles = [
        (f"{100 * client['cpu_share']:.0f} %", "of a core"),
        (f"{milliseconds(client['lag_s']['p99'])} ms", "late itself, p99"),
        (f"{milliseconds(client['lag_s']['max'])} ms", "late itself, at most"),
    ]
    return ["<h2>This program</h2>", f'<p class="sub">{escape(where)}</p>', _tiles(tiles)]


def _tiles(rows: Sequence[tuple[str, str]]) -> str:
    cells = (f'<div class="tile"><b>{escape(value)}</b><span>{escape(name)}</span></div>' for value, name in rows)
    return f'<div class="tiles">{"".join(cells)}</div>'


def _card(title: str, content: str) -> str:
    return f'<div class="card"><h3>{escape(title)}</h3>{content}</div>'


def _over_time(title: str, parts: Sequence[Json], interval_s: float) -> str:
    found = [Histogram.of_json(part) for part in parts]
    times = [(k + 0.5) * interval_s for k in range(len(found))]
    lines = [
        Line("max", 3, times, [1e3 * one.max if one.total else math.nan for one in found]),
        Line("p99", 2, times, [1e3 * one.percentile(99.0) for one in found]),
        Line("p50", 1, times, [1e3 * one.percentile(50.0) for one in found]),
    ]
    return _card(title, plot(lines, x_label="seconds", y_label="ms", log=True) + legend(lines[::-1]))


def _distribution(title: str, rows: Sequence[tuple[str, Sequence[Json]]]) -> str:
    lines = [Line(label, k + 1, *_quantiles(parts, 1e3), dashed=k == 1) for k, (label, parts) in enumerate(rows)]
    drawn = plot(lines, x_label="percentile", y_label="ms", log=True, x_ticks=NINES)
    return _card(title, drawn + legend(lines))


def _lengths(title: str, parts: Sequence[Json]) -> str:
    most = max((Histogram.of_json(part).max for part in parts), default=0.0)
    scale, unit = next(row for row in ((1e3, "mm"), (1e6, "µm"), (1e9, "nm")) if most * row[0] >= 1.0 or row[0] == 1e9)
    lines = [Line("distance between effector and goal", 4, *_quantiles(parts, scale))]
    return _card(title, plot(lines, x_label="percentile", y_label=unit, log=True, x_ticks=NINES) + legend(lines))


def _quantiles(parts: Sequence[Json], scale: float) -> tuple[list[float], list[float]]:
    whole = Histogram()
    for part in parts:
        whole.merge(Histogram.of_json(part))
    most = min(3.0, math.log10(max(whole.total, 2)))
    places = np.linspace(0.02, most, 200).tolist()
    return places, [scale * whole.percentile(100.0 * (1.0 - 10.0**-place)) for place in places]


def _rates(title: str, counts: Sequence[int], target_per_s: float, interval_s: float) -> str:
    times = [(k + 0.5) * interval_s for k in range(len(counts))]
    lines = [
        Line("achieved", 1, times, [count / interval_s for count in counts], filled=True),
        Line("target", 2, times, [target_per_s] * len(counts), dashed=True),
    ]
    return _card(f"{title} per second", plot(lines, x_label="seconds", y_label="per second") + legend(lines))


def _times_table(rows: Sequence[tuple[str, str]], summary: Json) -> str:
    if not rows:
        return ""
    cells = [[escape(label), str(summary[name]["count"]), *(milliseconds(summary[name][column]) for column in COLUMNS)]
             for label, name in rows]  # fmt: skip
    return f'<div class="card">{table(["milliseconds", "count", *COLUMNS], cells)}</div>'


def _errors(errors: Mapping[str, int], problems: Sequence[str]) -> str:
    shown = [f'<p class="note warn">{count} × {escape(name)}</p>' for name, count in sorted(errors.items())]
    return "".join(shown + [f'<p class="note bad">{escape(text)}</p>' for text in problems])
