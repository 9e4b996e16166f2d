"""What containers have to do, seen from outside: through the proxy, by Podman, and by Prometheus."""

from __future__ import annotations

import ctypes
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from adverb_client import Client, SyncStream

from verbs import library
from verbs.io import artifact

from .compose import Service
from .podman import Podman, TrialError

__all__ = ["CHECKS", "Trial", "until"]

VERB, REFINED = "reach", "arm3"
CLONE_NEWNET = 0x40000000


@dataclass
class Trial:
    """Running containers, and the proxy's address."""

    podman: Podman
    services: dict[str, Service]
    containers: dict[str, list[str]]

    @property
    def url(self) -> str:
        """Address of the proxy in its own network namespace."""
        port = self.services["proxy"].row["ports"][0].rpartition(":")[2]
        return f"http://127.0.0.1:{port}"

    @contextmanager
    def beside_proxy(self) -> Iterator[None]:
        """Sockets that are opened meanwhile are in the proxy's network namespace, where it is on loopback.

        Requests thus never cross the machine's own network, which may have filters.
        """
        key = self.podman.inspect(self.containers["proxy"][0])["NetworkSettings"]["SandboxKey"]
        with open("/proc/thread-self/ns/net", "rb") as before, open(key, "rb") as other:
            _enter(other.fileno())
            try:
                yield
            finally:
                _enter(before.fileno())

    def inside(self, container: str, *command: str, check: bool = True) -> str:
        """Output of a command in a container."""
        return self.podman.run("exec", container, *command, check=check).stdout.strip()

    def fetched(self, container: str, url: str) -> Any:
        """JSON at an address, requested inside a container that has wget."""
        return json.loads(self.inside(container, "wget", "--quiet", "--output-document=-", url))


def _enter(namespace: int) -> None:
    """Move this thread, and the threads that it starts, into a network namespace; `os.setns` needs Python 3.12."""
    if ctypes.CDLL(None, use_errno=True).setns(namespace, CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), "setns")


def until(condition: Callable[[], Any], what: str, *, seconds: float = 120.0, pause_s: float = 0.2) -> Any:
    """Wait until something holds, and return it; TrialError after some seconds."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > end:
            raise TrialError(f"not within {seconds:.0f} s: {what}")
        time.sleep(pause_s)
    return found


def require(condition: Any, what: str) -> None:
    """TrialError unless something holds."""
    if not condition:
        raise TrialError(what)


def hardened(trial: Trial) -> str:
    """No process is root, has capabilities, or could gain privileges; root file systems are read-only."""
    names = [name for found in trial.containers.values() for name in found]
    for name in names:
        pids = trial.podman.run("top", name, "hpid").stdout.split()[1:]
        for pid in pids:
            status = dict(
                row.split(":\t", 1)
                for row in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
                if ":\t" in row
            )
            require(status["Uid"].split()[0] != "0", f"{name}: process {pid} is root")
            require(
                int(status["CapEff"], 16) == int(status["CapBnd"], 16) == 0, f"{name}: process {pid} has capabilities"
            )
            require(status["NoNewPrivs"] == "1", f"{name}: process {pid} could gain privileges")
        root = next(row for row in trial.inside(name, "cat", "/proc/1/mounts").splitlines() if row.split()[1] == "/")
        require(root.split()[3].split(",")[0] == "ro", f"{name}: the root file system can be written")
    for name in trial.containers["server"] + trial.containers["worker"]:
        require(trial.inside(name, "id", "-u") == "10001", f"{name}: another user than 10001")
    return f"{len(names)} containers: no root, no capabilities, no new privileges, read-only root"


def page(trial: Trial) -> str:
    """The proxy forwards page, API and readiness, and hides metrics."""
    with trial.beside_proxy(), httpx.Client(base_url=trial.url, timeout=20) as client:
        html = client.get("/", headers={"Accept": "text/html"})
        require(html.status_code == 200 and "<script" in html.text, f"page: {html.status_code} {html.text[:200]}")
        require(client.get("/readyz").status_code == 200, "/readyz")
        require(client.get("/metrics").status_code == 404, "/metrics can be read through the proxy")
        require(
            client.get("/livez", headers={"Host": "stranger.example"}).status_code in (400, 403, 421),
            "any Host is served",
        )
    return "page, /readyz; /metrics hidden; other Host names refused"


def pose(trial: Trial) -> str:
    """A pose whose error is measured again here."""
    with trial.beside_proxy(), Client(trial.url) as client:
        verb, goal = client.verb(VERB), np.array([-0.3, 1.2, 0.4])
        found = client.pose(VERB, dict(zip("xyz", goal.tolist(), strict=True)), phase=verb.keytimes["apex"])
    hand = verb.skeleton.positions(found.root, found.rotations)[verb.skeleton.index("RightHand")]
    again = float(np.linalg.norm(hand - goal))
    require(
        found.error is not None and abs(again - found.error) < 1e-5, f"error {found.error} m, measured here {again} m"
    )
    return f"error {found.error} m, measured here {again} m"


def stream(trial: Trial) -> str:
    """A WebSocket through the proxy: a character that follows goals."""
    with trial.beside_proxy(), SyncStream(trial.url) as connection:
        channel = connection.open(VERB, fps=60)
        channel.aim([-0.2, 1.3, 0.4])
        until(lambda: connection.stats.messages >= 120, "120 messages of a stream", seconds=30)
        stats, round_trip = connection.stats, connection.ping()
        require(channel.pose() is not None, "no pose of the stream")
    counts = f"{stats.messages} messages, {stats.missing} missing, {stats.dropped} dropped"
    return f"{counts}, round trip {1e3 * round_trip:.1f} ms"


def upload(trial: Trial) -> str:
    """A verb is published through the proxy, and served by every server with the same bytes."""
    with (
        tempfile.TemporaryDirectory() as folder,
        trial.beside_proxy(),
        httpx.Client(base_url=trial.url, timeout=120) as client,
    ):
        file = Path(folder) / "uploaded.verb"
        artifact.save(replace(library.load(REFINED), name="uploaded"), file)
        content = file.read_bytes()
        began = time.monotonic()
        answer = client.post("/v1/verbs", content=content, headers={"Content-Type": "application/octet-stream"})
        require(answer.status_code == 201, f"upload: {answer.status_code} {answer.text}")
        took_s = time.monotonic() - began
        require(client.get("/v1/verbs/uploaded/versions/1").content == content, "the artifact has other bytes")
    _everywhere(trial, "uploaded", 1)
    return f"{len(content) / 1e3:.0f} kB in {took_s:.2f} s, on every server"


def refinement(trial: Trial) -> str:
    """A refinement that a worker runs and every server serves."""
    with trial.beside_proxy(), httpx.Client(base_url=trial.url, timeout=20) as client:
        began = time.monotonic()
        job = (
            client.post(f"/v1/verbs/{REFINED}/refinements", json={"for": "error", "max_pseudo": 40})
            .raise_for_status()
            .json()
        )
        ended = {"published", "not_better", "failed", "cancelled", "given_up"}

        def row() -> dict[str, Any]:
            return dict(client.get(f"/v1/refinements/{job['id']}").json())

        until(lambda: row()["state"] in ended, "a refinement ends", seconds=300)
        found = row()
    require(found["state"] == "published", f"refinement: {found}")
    logs = {name: trial.podman.run("logs", name) for name in trial.containers["worker"]}
    ran = [name for name, log in logs.items() if job["id"] in log.stdout + log.stderr]
    require(ran, "no worker logged the refinement")
    _everywhere(trial, REFINED, found["version_after"])
    return f"published version {found['version_after']} in {time.monotonic() - began:.1f} s by {', '.join(ran)}"


def _everywhere(trial: Trial, verb: str, version: int) -> None:
    program = (
        f"from urllib.request import urlopen; print(urlopen('http://127.0.0.1:8000/v1/verbs/{verb}').read().decode())"
    )

    def served(name: str) -> bool:
        text = trial.inside(name, "python", "-c", program, check=False)
        return bool(text) and json.loads(text)["version"] == version

    for name in trial.containers["server"]:
        until(partial(served, name), f"{name} serves version {version} of {verb}", seconds=20)


def scraped(trial: Trial) -> str:
    """Prometheus finds every server, has loaded every rule, and has the metrics."""
    (name,) = trial.containers["prometheus"]
    api = "http://127.0.0.1:9090/api/v1"

    def up() -> list[str]:
        rows = trial.fetched(name, f"{api}/targets")["data"]["activeTargets"]
        return [row["health"] for row in rows if row["labels"]["job"] == "adverb"]

    wanted = ["up"] * len(trial.containers["server"])
    until(lambda: up() == wanted, f"Prometheus scrapes {len(wanted)} servers", seconds=60, pause_s=1)
    groups = trial.fetched(name, f"{api}/rules")["data"]["groups"]
    rules = [rule for group in groups for rule in group["rules"]]
    require(rules and all(rule["health"] != "err" for rule in rules), f"rules: {rules}")

    def poses() -> list[Any]:
        return list(trial.fetched(name, f"{api}/query?query=sum(adverb_poses_total)")["data"]["result"])

    until(poses, "Prometheus has poses", seconds=30, pause_s=1)
    return f"{len(wanted)} servers up, {len(rules)} alert rules, {poses()[0]['value'][1]} poses counted"


def server_lost(trial: Trial) -> str:
    """One server is killed: the proxy answers from the others."""
    victim, *others = trial.containers["server"]
    require(others, "a single server is no cluster")
    trial.podman.run("kill", "--signal=KILL", victim)
    with trial.beside_proxy(), httpx.Client(base_url=trial.url, timeout=20) as client:
        answers = [client.get("/v1/verbs").status_code for _ in range(100)]
    trial.podman.remove(victim)
    trial.containers["server"].remove(victim)
    require(set(answers) == {200}, f"answers after a server died: {answers}")
    return "100 of 100 requests answered after a server was killed"


def drained(trial: Trial) -> str:
    """Stopping is orderly: every container ends by itself within its time, with exit code 0."""
    took: dict[str, float] = {}
    for service in reversed(list(trial.containers)):
        for name in trial.containers[service]:
            began = time.monotonic()
            trial.podman.run("stop", name)
            took[service] = max(took.get(service, 0.0), time.monotonic() - began)
            code = trial.podman.inspect(name)["State"]["ExitCode"]
            require(code == 0, f"{name}: exit code {code} after SIGTERM")
    return ", ".join(f"{name} {seconds:.1f} s" for name, seconds in took.items())


CHECKS: list[Callable[[Trial], str]] = [
    hardened, page, pose, stream, upload, refinement, scraped, server_lost, drained,
]  # fmt: skip
