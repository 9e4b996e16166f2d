"""The project's image, and stand-ins for the images that it and docker-compose.yml name, made of Debian packages.

Addresses of registries come from this machine's configuration of apt, pip and npm, which images do not keep.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import time
from pathlib import Path

from .podman import Podman, TrialError

__all__ = ["build", "stand_ins"]

BASES = Path(__file__).parent / "bases"
SUITES = {"python": "bookworm", "node": "bookworm", "postgres": "trixie", "nginx": "sid", "prom/prometheus": "sid"}
"""Release of Debian that has the program of an image in the right version."""


def stand_ins(podman: Podman, wanted: list[str]) -> list[str]:
    """Make the images that have a stand-in and are not there yet; the names of those that have none."""
    for image in wanted:
        name = image.partition(":")[0]
        if name in SUITES and not podman.has_image(f"localhost/{image}"):
            _suite(podman, SUITES[name])
            file = BASES / f"{name.rpartition('/')[2]}.Containerfile"
            _build(podman, f"localhost/{image}", file, BASES)
    return [image for image in wanted if image.partition(":")[0] not in SUITES]


def build(podman: Podman, image: str, project: Path) -> float:
    """Build the project's Dockerfile; the time that it took, seconds."""
    bases = re.findall(r"^FROM (\S+)", (project / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    if missing := stand_ins(podman, sorted(set(bases), reverse=True)):
        raise TrialError(f"the Dockerfile is built from {missing}, for which there is no stand-in")
    began = time.monotonic()
    _build(podman, f"localhost/{image}", project / "Dockerfile", project)
    return time.monotonic() - began


def _build(podman: Podman, tag: str, file: Path, context: Path) -> None:
    log = podman.folder / f"build-{file.name}.log"
    options = ["--isolation=chroot", "--network=host", "--pull=never", "--format=docker"]
    with log.open("w", encoding="utf-8") as to:
        command = [
            *podman.program,
            "build",
            *options,
            *_configuration(podman),
            f"--tag={tag}",
            f"--file={file}",
            str(context),
        ]
        if subprocess.run(command, stdout=to, stderr=to, check=False).returncode:
            raise TrialError(f"{file.name} cannot be built, see {log}: {log.read_text(encoding='utf-8')[-4000:]}")


def _suite(podman: Podman, suite: str) -> None:
    """A minimal Debian of this name, from the mirror that apt uses here."""
    if podman.has_image(f"localhost/{suite}"):
        return
    folder = podman.folder / suite
    shutil.rmtree(folder, ignore_errors=True)
    log = podman.folder / f"debootstrap-{suite}.log"
    with log.open("w", encoding="utf-8") as to:
        command = ["debootstrap", "--variant=minbase", suite, str(folder), _mirror()]
        if subprocess.run(command, stdout=to, stderr=to, check=False).returncode:
            raise TrialError(f"debootstrap {suite} failed, see {log}: {log.read_text(encoding='utf-8')[-2000:]}")
    with subprocess.Popen(["tar", "--directory", str(folder), "--create", "."], stdout=subprocess.PIPE) as archive:
        podman.run("import", "--quiet", "-", f"localhost/{suite}:latest", stdin=archive.stdout)
    shutil.rmtree(folder)


def _mirror() -> str:
    """The first archive that apt has of this machine's Debian."""
    rows = subprocess.run(
        ["apt-get", "indextargets", "--format", "$(REPO_URI) $(ORIGIN) $(LABEL)", "Created-By: Packages"],
        capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    found = [row.split()[0] for row in rows if row.endswith(" Debian Debian")]
    if not found:
        raise TrialError("apt has no archive of Debian here; run `apt-get update`")
    return found[0]


def _configuration(podman: Podman) -> list[str]:
    """Volumes of a build that hold this machine's settings of apt, pip and npm: mirrors and certificates."""
    folder = podman.folder / "configuration"
    folder.mkdir(exist_ok=True)
    volumes = []
    bundle = os.environ.get("SSL_CERT_FILE", "/etc/ssl/certs/ca-certificates.crt")
    certificates = "/run/trial/certificates"
    if Path(bundle).exists():
        volumes.append(f"--volume={bundle}:{certificates}:ro")
    pip = ["[global]", f"cert = {certificates}"]
    pip += [f"index-url = {found}"] if (found := _printed("pip", "config", "get", "global.index-url")) else []
    npm = [f"cafile={certificates}", f"registry={_printed('npm', 'config', 'get', 'registry')}", "audit=false"]
    dump = _printed("apt-config", "dump")
    apt = [row for row in dump.splitlines() if re.match(r"Acquire::(Check|https?::)", row) and not row.endswith('"";')]
    for name, rows, target in (
        ("pip", pip, "/etc/pip.conf"),
        ("npm", [row for row in npm if not row.endswith("=")], "/root/.npmrc"),
        ("apt", apt, "/etc/apt/apt.conf.d/99trial"),
    ):
        (folder / name).write_text("\n".join([*rows, ""]), encoding="utf-8")
        volumes.append(f"--volume={folder / name}:{target}:ro")
    return volumes


def _printed(*command: str) -> str:
    if shutil.which(command[0]) is None:
        return ""
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
