"""The report as lines of text, and the faults that it has."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

__all__ = ["faults_of", "lines_of", "milliseconds", "quantity", "warnings_of"]

Json = Mapping[str, Any]
BUSY = 0.8
"""Share of a core from which on the client may be what is slow."""


def milliseconds(seconds: float | None) -> str:
    """A time in milliseconds, three digits."""
    if seconds is None or math.isnan(seconds):
        return "–"
    value = 1e3 * seconds
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def quantity(metres: float | None) -> str:
    """A length with a unit that suits it."""
    if metres is None or math.isnan(metres):
        return "–"
    for scale, unit in ((1.0, "m"), (1e3, "mm"), (1e6, "µm")):
        if metres * scale >= 1.0:
            return f"{metres * scale:.3g} {unit}"
    return f"{metres * 1e9:.3g} nm"


def faults_of(report: Json) -> list[str]:
    """Everything that a sound server never does: malformed bytes, unreported gaps, wrong errors, no success at all."""
    found = []
    for group in report["streams"]:
        frames, poses = group["frames"], group["poses"]
        found += [f"{group['name']}: no frame arrived"] if not frames["frames"] else []
        found += [f"{group['name']}: {frames['faults']} malformed messages"] if frames["faults"] else []
        found += [f"{group['name']}: {frames['gaps']} messages are missing unreported"] if frames["gaps"] else []
        found += (
            [f"{group['name']}: {poses['disagree']} poses are not where their errors state"]
            if poses["disagree"]
            else []
        )
    for group in report["requests"]:
        counts = group["requests"]
        found += [f"{group['name']}: no request succeeded"] if counts["scheduled"] and not counts["good"] else []
        found += [f"{group['name']}: {counts['faults']} malformed responses"] if counts["faults"] else []
        found += (
            [f"{group['name']}: {counts['disagree']} poses are not where their errors state"]
            if counts["disagree"]
            else []
        )
    return found


def warnings_of(report: Json) -> list[str]:
    """Reasons to doubt the figures."""
    client, found = report["client"], []
    if report["interrupted"]:
        found.append(f"interrupted after {report['seconds']:g} of {report['profile']['duration_s']:g} s")
    if client["cpu_share"] > BUSY:
        found.append(
            f"this program used {100 * client['cpu_share']:.0f} % of a core: it may be what is slow; use less load"
        )
    for group in report["streams"]:
        failed = sum(group["opened"]["failed"].values()) + sum(group["errors"].values())
        found += [f"{group['name']}: {failed} sockets or channels failed"] if failed else []
        held = group["goals"]["held_back"]
        found += [f"{group['name']}: {held} goals were not sent, since their sockets were full"] if held else []
    for group in report["requests"]:
        failed = sum(group["errors"].values())
        found += [f"{group['name']}: {failed} of {group['requests']['scheduled']} requests failed"] if failed else []
        target, sent = group["requests"]["scheduled_per_s"], group["requests"]["sent_per_s"]
        if sent < 0.98 * target:
            found.append(
                f"{group['name']}: {sent:g} of {target:g} requests a second were sent; the rest had no connection"
            )
    return found


def lines_of(report: Json) -> list[str]:
    """The report for a terminal."""
    profile = report["profile"]
    lines = [f"{profile['name']}: {report['seconds']:g} s against {report['server']}, seed {report['seed']}", ""]
    for group in report["streams"]:
        lines += [*_stream_lines(group), ""]
    for group in report["requests"]:
        lines += [*_request_lines(group), ""]
    client = report["client"]
    lag = client["lag_s"]
    lines.append(
        f"client      {100 * client['cpu_share']:.0f} % of a core, late by p50 {milliseconds(lag['p50'])}, "
        f"p99 {milliseconds(lag['p99'])}, max {milliseconds(lag['max'])} ms"
    )
    lines += [f"warning     {text}" for text in warnings_of(report)]
    return lines + [f"fault       {text}" for text in faults_of(report)]


def _stream_lines(group: Json) -> list[str]:
    plan, frames, goals, poses, summary = (group[name] for name in ("plan", "frames", "goals", "poses", "summary"))
    share = 100.0 * frames["per_s"] / frames["target_per_s"]
    lines = [
        f"{group['name']}: {plan['sockets']} sockets × {plan['channels']} channels of {', '.join(plan['verbs'])}, "
        f"{plan['fps']} fps, {plan['encoding']}",
        f"  frames    {frames['per_s']:g} of {frames['target_per_s']:g} a second ({share:.1f} %), "
        f"{frames['poses']} poses, {frames['bytes'] / 1e6:.1f} MB",
        f"  lost      {frames['dropped']} dropped, {frames['skipped']} skipped, {frames['gaps']} missing unreported; "
        f"{frames['dropped_slow']} dropped for slow readers",
    ]
    if summary["lateness_s"]["count"]:
        lines += [f"  lateness  {_times(summary['lateness_s'])}", f"  spacing   {_times(summary['spacing_s'])}"]
    if goals["target_per_s"]:
        lines.append(
            f"  goals     {goals['per_s']:g} of {goals['target_per_s']:g} a second, {goals['held_back']} held back"
        )
    if summary["response_s"]["count"]:
        lines.append(f"  response  {_times(summary['response_s'])}, goal to frame")
    if poses["measured"]:
        lines.append(f"  error     {_lengths(summary['error_m'])}, {_measured(poses)}")
    if poses["heads"]:
        stated = quantity(poses["stated_error_max_m"])
        lines.append(f"  stated    {stated} at most in {poses['heads']} heads of records, {poses['clamped']} clamped")
    return (
        lines
        + _errors({**group["errors"], **group["opened"]["failed"]})
        + [f"  problem   {row}" for row in group["problems"]]
    )


def _request_lines(group: Json) -> list[str]:
    plan, counts, summary = group["plan"], group["requests"], group["summary"]
    kind = plan["route"] if plan["route"] in ("verbs", "health") else f"{plan['route']} of {plan['verb']}"
    lines = [
        f"{group['name']}: {kind}, {plan['accept']}, {plan['arrivals']} arrivals",
        f"  rate      {counts['per_s']:g} of {counts['target_per_s']:g} requested a second "
        f"({counts['scheduled_per_s']:g} scheduled), {counts['connections']} connections",
        f"  latency   {_times(summary['latency_s'])}, from the scheduled time",
        f"  service   {_times(summary['service_s'])}, from sending",
    ]
    if counts["measured"]:
        lines.append(f"  error     {_lengths(summary['error_m'])}, {_measured(counts)}")
    if counts["unchecked"]:
        lines.append(f"  checked   {counts['checked']} responses; {counts['unchecked']} were not, to save time")
    return lines + _errors(group["errors"]) + [f"  problem   {row}" for row in group["problems"]]


def _measured(counts: Json) -> str:
    return f"measured on {counts['measured']} poses; {counts['disagree']} disagree with the server"


def _errors(errors: Mapping[str, int]) -> list[str]:
    if not errors:
        return []
    return ["  failed    " + ", ".join(f"{count} × {name}" for name, count in sorted(errors.items()))]


def _times(summary: Json) -> str:
    names = ("p50", "p90", "p99", "p99.9", "max")
    return "  ".join(f"{name} {milliseconds(summary[name])}" for name in names) + " ms"


def _lengths(summary: Json) -> str:
    return f"p50 {quantity(summary['p50'])}  p99 {quantity(summary['p99'])}  max {quantity(summary['max'])}"
