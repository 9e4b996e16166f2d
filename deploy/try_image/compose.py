"""docker-compose.yml as arguments of Podman. A key that is not translated is an error, so what runs is what is written.

Ports are not published on the machine, and every network is internal: a trial opens no way in or out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

__all__ = ["Service", "interpolated", "read"]

TRANSLATED = {
    "build", "cap_drop", "command", "depends_on", "deploy", "environment", "healthcheck", "image", "init", "networks",
    "ports", "read_only", "restart", "security_opt", "stop_grace_period", "tmpfs", "user", "volumes",
}  # fmt: skip
FLAGS = {"init": ["--init"], "read_only": ["--read-only", "--read-only-tmpfs=false"]}
TMPFS = "rw,noexec,nosuid,nodev,notmpcopyup"
"""Options that Docker gives a tmpfs by default, in Podman's words."""


def interpolated(text: str, given: Mapping[str, str]) -> str:
    """Text with ``${NAME:-default}`` and ``${NAME:?problem}`` replaced; KeyError where the latter is not given."""
    found = re.sub(r"\$\{(\w+):-([^}]*)\}", lambda match: given.get(match[1], match[2]), text)
    return re.sub(r"\$\{(\w+):\?[^}]+\}", lambda match: given[match[1]], found)


class Service:
    """One service of a Compose file."""

    def __init__(self, name: str, row: dict[str, Any], project: Path) -> None:
        unknown = set(row) - TRANSLATED
        if unknown:
            raise ValueError(
                f"{name}: {', '.join(sorted(unknown))} would not be tried; add it to {Path(__file__).name}"
            )
        self.name, self.row, self.project = name, row, project

    @property
    def image(self) -> str:
        """Name and tag of the image."""
        return str(self.row["image"])

    @property
    def built(self) -> bool:
        """Whether the project builds the image."""
        return "build" in self.row

    @property
    def replicas(self) -> int:
        """Number of containers."""
        return int(self.row.get("deploy", {}).get("replicas", 1))

    @property
    def networks(self) -> list[str]:
        """Names of its networks."""
        return list(self.row["networks"])

    @property
    def needs(self) -> list[str]:
        """Services that have to be healthy before this one starts."""
        return list(self.row.get("depends_on", {}))

    @property
    def patience_s(self) -> float:
        """Time until an unhealthy container counts as failed: start period and retries, seconds."""
        check = self.row.get("healthcheck", {})
        interval = _seconds(check.get("interval", "10s"))
        return _seconds(check.get("start_period", "60s")) + int(check.get("retries", 3)) * interval

    @property
    def check(self) -> list[str] | None:
        """Health check, ``["CMD", …]``; None where the image has its own."""
        return list(self.row["healthcheck"]["test"]) if "healthcheck" in self.row else None

    def arguments(self) -> list[str]:
        """Arguments of ``podman create`` before the image: everything but name and networks."""
        return list(self._arguments())

    def command(self) -> list[str]:
        """Arguments after the image."""
        return [str(word) for word in self.row.get("command", [])]

    def _arguments(self) -> Iterator[str]:
        row = self.row
        yield from (flag for key, flags in FLAGS.items() if row.get(key) for flag in flags)
        yield from (f"--cap-drop={name}" for name in row.get("cap_drop", []))
        yield from (f"--security-opt={name.removesuffix(':true')}" for name in row.get("security_opt", []))
        if "restart" in row:
            yield f"--restart={row['restart']}"
        if "user" in row:
            yield f"--user={row['user']}"
        if "stop_grace_period" in row:
            yield f"--stop-timeout={_seconds(row['stop_grace_period']):.0f}"
        yield from (f"--env={name}={value}" for name, value in row.get("environment", {}).items())
        for mount in row.get("tmpfs", []):
            path, _, options = mount.partition(":")
            yield f"--tmpfs={path}:{TMPFS}" + (f",{options}" if options else "")
        for volume in row.get("volumes", []):
            source, _, target = volume.partition(":")
            yield f"--volume={self.project / source if source.startswith('.') else source}:{target}"


def _seconds(text: str) -> float:
    number, unit = re.fullmatch(r"(\d+)(s|m)", text).groups()  # type: ignore[union-attr]
    return int(number) * {"s": 1.0, "m": 60.0}[unit]


def read(path: Path, given: Mapping[str, str]) -> tuple[dict[str, Service], list[str]]:
    """Services of a Compose file in the order in which they can start, and the names of its networks."""
    document = yaml.safe_load(interpolated(path.read_text(encoding="utf-8"), given))
    services = {name: Service(name, row, path.parent) for name, row in document["services"].items()}
    ordered: dict[str, Service] = {}
    while len(ordered) < len(services):
        ready = [row for name, row in services.items() if name not in ordered and set(row.needs) <= set(ordered)]
        if not ready:
            raise ValueError("depends_on has a circle")
        ordered |= {row.name: row for row in ready}
    return ordered, list(document["networks"])
