"""Build the image without Docker, start docker-compose.yml's containers, and check what they do.

python -m deploy.try_image [--folder DIR] [--no-build] [--remove-images]

Needs Debian, root, and the packages that it lists when they are missing. Images are kept in DIR and reused; containers,
networks and volumes are removed at the end. Exit code 0 if everything holds.
"""

from __future__ import annotations

import argparse
import os
import secrets
import shutil
import sys
import time
from functools import partial
from pathlib import Path

from . import compose, images
from .checks import CHECKS, Trial, until
from .podman import Podman, TrialError

PROJECT = Path(__file__).parents[2]


def main() -> int:
    """Read the command line, and run the trial."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("/var/tmp/adverb-try-image"), help="images and logs")
    parser.add_argument("--remove-images", action="store_true", help="remove the folder at the end")
    parser.add_argument("--no-build", action="store_true", help="use the image that the last run built")
    options = parser.parse_args()
    if os.geteuid() != 0:
        parser.error("needs root: containers get users and networks of their own")
    try:
        trial(options)
    except TrialError as failed:
        print(f"FAILED: {failed}", file=sys.stderr)
        return 1
    finally:
        if options.remove_images:
            shutil.rmtree(options.folder, ignore_errors=True)
    return 0


def trial(options: argparse.Namespace) -> None:
    """Build, start, check, clean up."""
    given = {"POSTGRES_PASSWORD": secrets.token_hex(24), "GRAFANA_PASSWORD": "unused"}
    services, networks = compose.read(PROJECT / "docker-compose.yml", given)
    podman = Podman(options.folder)
    built = next(row.image for row in services.values() if row.built)
    if not options.no_build:
        print(f"built    {built} in {images.build(podman, built, PROJECT):.0f} s", flush=True)
    size = podman.inspect(f"localhost/{built}")["Size"] / 1e6
    base = podman.inspect("localhost/python:3.11-slim")["Size"] / 1e6
    print(f"image    {size:.0f} MB, of which {base:.0f} MB are the base", flush=True)
    for image in images.stand_ins(podman, [row.image for row in services.values() if not row.built]):
        print(f"left out {image}: no stand-in")
        services = {name: row for name, row in services.items() if row.image != image}
    with podman.cleaning_up():
        for name in networks:
            podman.run("network", "create", "--internal", name)
        running = Trial(podman, services, {})
        for service in services.values():
            print(f"healthy  {service.name:<12} {started(running, service):.1f} s", flush=True)
        for check in CHECKS:
            print(f"holds    {check.__name__:<12} {check(running)}", flush=True)


def started(trial: Trial, service: compose.Service) -> float:
    """Start the containers of a service, wait until all are healthy; the time that it took, seconds."""
    began = time.monotonic()
    names = trial.containers[service.name] = [f"{service.name}-{number}" for number in range(1, service.replicas + 1)]
    networks = [f"--network={name}" for name in service.networks]
    for name in names:
        trial.podman.start(
            name, service.name, [*networks, *service.arguments()], [f"localhost/{service.image}", *service.command()]
        )
    for name in names:
        try:
            until(partial(healthy, trial.podman, service, name), f"{name} is healthy", seconds=service.patience_s)
        except TrialError as failed:
            logs = trial.podman.run("logs", "--tail=40", name, check=False)
            raise TrialError(f"{failed}\n{(logs.stdout + logs.stderr)[-3000:]}") from None
    return time.monotonic() - began


def healthy(podman: Podman, service: compose.Service, name: str) -> bool:
    """Whether the health check of Compose or of the image passes in a container; TrialError if its process ended."""
    if not podman.inspect(name)["State"]["Running"]:
        raise TrialError(f"{name} has ended")
    kind, *command = service.check or podman.inspect(f"localhost/{service.image}")["Healthcheck"]["Test"]
    if kind != "CMD":
        raise TrialError(f"{name}: health checks of the kind {kind} are not tried")
    return podman.run("exec", name, *command, check=False).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
