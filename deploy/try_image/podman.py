"""Podman with a store of its own, and names for containers as Docker's DNS gives them."""

from __future__ import annotations

import json
import resource
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

__all__ = ["Podman", "TrialError"]

PROGRAMS = {"podman": "podman", "runc": "runc", "catatonit": "catatonit", "debootstrap": "debootstrap"} | {
    "dnsmasq": "dnsmasq-base", "nsenter": "util-linux", "ip": "iproute2", "iptables": "iptables", "conmon": "conmon",
}  # fmt: skip
"""Programs that a trial calls, and the Debian package of each."""

DNS = "127.0.0.11"
"""Address of Docker's DNS inside every container; nginx.conf names it."""


class TrialError(RuntimeError):
    """Something that the trial shows to be wrong."""


class Podman:
    """Images, containers and networks in a folder, apart from those of the machine."""

    def __init__(self, folder: Path) -> None:
        missing = sorted({package for name, package in PROGRAMS.items() if shutil.which(name, path=_path()) is None})
        if missing:
            raise TrialError(f"install these packages first: {' '.join(missing)}")
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.program = [
            "podman", f"--root={folder / 'store'}", f"--runroot={folder / 'run'}", f"--tmpdir={folder / 'tmp'}",
            f"--network-config-dir={folder / 'networks'}", "--storage-driver=overlay", "--runtime=runc",
            "--cgroup-manager=cgroupfs", "--events-backend=none",
        ]  # fmt: skip
        self.names = folder / "names"
        self._addresses: dict[str, list[tuple[str, str]]] = {}
        self._dns: dict[str, subprocess.Popen[bytes]] = {}

    def run(self, *arguments: str, check: bool = True, **options: Any) -> subprocess.CompletedProcess[str]:
        """Run a command of Podman; TrialError with its output if it fails."""
        done = subprocess.run([*self.program, *arguments], capture_output=True, text=True, check=False, **options)
        if check and done.returncode:
            raise TrialError(f"podman {' '.join(arguments[:4])} …: {(done.stdout + done.stderr)[-4000:]}")
        return done

    def inspect(self, name: str) -> dict[str, Any]:
        """Everything about a container or an image."""
        return dict(json.loads(self.run("inspect", name).stdout)[0])

    def has_image(self, name: str) -> bool:
        """Whether an image exists."""
        return self.run("image", "exists", name, check=False).returncode == 0

    def start(self, name: str, service: str, arguments: list[str], after: list[str]) -> None:
        """Create a container, give it a DNS server, and start its process."""
        open_files = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        limits = [f"--ulimit=nofile={open_files}:{open_files}", "--ulimit=nproc=32768:32768"]
        self.run(
            "create", f"--name={name}", "--pull=never", "--no-healthcheck", f"--dns={DNS}", *limits, *arguments, *after
        )
        self.run("init", name)
        found = self.inspect(name)["NetworkSettings"]
        self._addresses[name] = [(row["IPAddress"], service) for row in found["Networks"].values()]
        self._write_names()
        self._dns[name] = subprocess.Popen(
            [
                "nsenter", f"--net={found['SandboxKey']}", "dnsmasq", "--keep-in-foreground", f"--listen-address={DNS}",
                "--bind-interfaces", "--local=/#/", "--no-resolv", "--no-hosts",
                f"--addn-hosts={self.names}", "--user=root", "--pid-file",
                "--conf-file=/dev/null", "--log-facility=/dev/null",
            ],
            env={"PATH": _path()},
        )  # fmt: skip
        self.run("start", name)

    def remove(self, name: str) -> None:
        """Remove a container, its DNS server and its names."""
        self.run("rm", "--force", "--ignore", "--time=5", name, check=False)
        if name in self._dns:
            dns = self._dns.pop(name)
            dns.terminate()
            dns.wait(timeout=10)
        if self._addresses.pop(name, None):
            self._write_names()

    def running(self) -> list[str]:
        """Names of the containers that this trial started and has not removed."""
        return list(self._addresses)

    @contextmanager
    def cleaning_up(self) -> Iterator[None]:
        """Remove containers, volumes and networks at the end, also after an error; images stay."""
        self._clean()
        try:
            yield
        finally:
            self._clean()

    def _clean(self) -> None:
        for name in self.run("ps", "--all", "--format={{.Names}}").stdout.split():
            self.remove(name)
        self.run("volume", "prune", "--force")
        self.run("network", "prune", "--force")

    def _write_names(self) -> None:
        rows = [f"{address} {service}\n" for found in self._addresses.values() for address, service in found]
        self.names.write_text("".join(rows), encoding="utf-8")
        for dns in self._dns.values():
            dns.send_signal(signal.SIGHUP)


def _path() -> str:
    return "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
