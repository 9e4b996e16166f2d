"""Try what ``make dist`` has built: install each part into an empty environment and run its first example.

``python -m tools.try_dist [DIST]``: nothing of the repository is on the paths but the files in the folder. The server
is that of the wheel; its first start compiles kernels, which takes minutes. Parts whose tools are absent are left out
and listed. Packages come from the cache of earlier installations where it has them. Exit status 1: a part failed.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["main"]

ROOT = Path(__file__).parents[1]
PATIENCE_S = 900.0
SERVER = "http://127.0.0.1:8000"
LOCK = ROOT / "requirements.runtime.lock"

PYTHON = """
from adverb_client import Client
pose = Client("{server}").pose("reach", {{"x": -0.3, "y": 1.2, "z": 0.4}}, phase=0.5)
print(pose.rotations.shape, pose.error)
"""

CSHARP = """
using System;
using System.Threading.Tasks;
using Adverb;

static class First
{{
    static async Task Run() {{ {example} }}

    static int Main() {{ return Run().Wait(60000) ? 0 : 1; }}
}}
"""

GODOT = """extends SceneTree

func _initialize():
{example}
\tquit()
"""


class Failed(Exception):
    """A command failed; the text has its output."""


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Output of a command in an environment without the repository."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env={**kept, **environment}, capture_output=True, text=True,
        timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    if done.returncode:
        raise Failed(f"{command[0]}: exit status {done.returncode}\n{(done.stdout + done.stderr)[-3_000:]}")
    return done.stdout


def install(folder: Path, *wheels: Path) -> Path:
    """Program folder of a new virtual environment with wheels, at the locked versions."""
    uv = Path(sys.executable).with_name("uv")
    run(uv, "venv", "-q", "--python", sys.executable, folder / "venv", cwd=folder)
    python = folder / "venv" / "bin" / "python"
    constraints = folder / "constraints.txt"
    pinned = re.findall(r"^[A-Za-z0-9_.-]+==[^\\\n]+", LOCK.read_text("utf-8"), re.MULTILINE)  # with their markers
    constraints.write_text("\n".join(row.strip() for row in pinned) + "\n")
    command: list[str | Path] = [uv, "pip", "install", "-q", "--python", python, "-c", constraints, *wheels]
    try:
        run(*command, "--offline", cwd=folder)
    except Failed:
        run(*command, cwd=folder)
    return python.parent


@contextmanager
def served(programs: Path, folder: Path) -> Iterator[str]:
    """A server of the installed wheel: its address, once it is ready."""
    log = folder / "log.txt"
    (folder / "data").mkdir()
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
    environment = {**kept, "NUMBA_CACHE_DIR": str(folder / "cache"), "ADVERB_REFINERS": "0"}
    command = [str(programs / "adverb"), "serve", "--port", "0", "--data", str(folder / "data")]
    with log.open("w") as stream:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=stream, stderr=stream)
    try:
        end = time.monotonic() + PATIENCE_S
        while not (found := re.search(r"ready on (http://127\.0\.0\.1:\d+)", log.read_text("utf-8"))):
            if process.poll() is not None or time.monotonic() > end:
                raise Failed(f"the server did not start\n{log.read_text('utf-8')[-3_000:]}")
            time.sleep(0.2)
        yield found[1]
    finally:
        process.terminate()
        process.wait(60)


def first_block(readme: Path, language: str, server: str) -> str:
    """The first example of a README."""
    found = re.search(rf"```{language}\n(.*?)```", readme.read_text("utf-8"), re.DOTALL)
    if found is None:
        raise Failed(f"{readme} has no example in {language}")
    return found[1].replace(SERVER, server)


def try_client(dist: Path, folder: Path, server: str) -> str:
    """The Python client alone: a pose, and the load tester."""
    programs = install(folder, next(dist.glob("adverb_client-*.whl")))
    shown = run(programs / "python", "-c", PYTHON.format(server=server), cwd=folder).strip()
    run(programs / "adverb-load", "--url", server, "--profile", "dashboard", "--scale", "0.05", "--duration", "2",
        "--json", folder / "load.json", "--quiet", cwd=folder)  # fmt: skip
    return shown


def try_npm(dist: Path, folder: Path, server: str) -> str:
    """The npm package in an empty project."""
    (folder / "package.json").write_text('{"name": "empty", "private": true, "type": "module"}')
    package = next(dist.glob("adverb-client-*.tgz"))
    run("npm", "install", "--offline", "--no-audit", "--no-fund", "--ignore-scripts", package, cwd=folder)
    readme = folder / "node_modules" / "adverb-client" / "README.md"
    (folder / "first.js").write_text(first_block(readme, "js", server))
    return run("node", "first.js", cwd=folder).strip().splitlines()[0]


def try_csharp(dist: Path, folder: Path, server: str) -> str:
    """The file of the C# client, compiled with the first example of its README."""
    shutil.copy(dist / "Adverb.cs", folder)
    example = first_block(ROOT / "clients" / "csharp" / "README.md", "csharp", server)
    (folder / "First.cs").write_text(CSHARP.format(example=example))
    run("mcs", "-langversion:6", "-r:System.Net.Http.dll", "-out:first.exe", "Adverb.cs", "First.cs", cwd=folder)
    return run("mono", "first.exe", cwd=folder).strip()


def try_godot(dist: Path, folder: Path, server: str) -> str:
    """The addon for Godot 3 in an empty project."""
    zipfile.ZipFile(dist / "adverb-godot3.zip").extractall(folder)
    (folder / "project.godot").write_text('config_version=4\n\n[application]\n\nconfig/name="empty"\n')
    block = first_block(ROOT / "README.md", "gdscript", server).replace("    ", "\t")
    body = "".join(f"\t{line}\n" for line in block.splitlines())
    (folder / "first.gd").write_text(GODOT.format(example=body))
    shown = run("godot3-server", "--path", folder, "-s", "first.gd", cwd=folder, HOME=str(folder))
    return next(line for line in shown.splitlines() if "hips" in line)


def try_blender(dist: Path, folder: Path, server: str) -> str:
    """The archive of the Blender add-on: its modules compile (Blender itself runs outside of the gate)."""
    zipfile.ZipFile(dist / "adverb-blender.zip").extractall(folder)
    run(sys.executable, "-m", "compileall", "-q", folder, cwd=folder)
    return f"{len(list(folder.glob('*.py')))} modules"


PARTS: dict[str, tuple[Callable[[Path, Path, str], str], tuple[str, ...]]] = {
    "adverb_client wheel": (try_client, ()),
    "npm package": (try_npm, ("npm", "node")),
    "Adverb.cs": (try_csharp, ("mcs", "mono")),
    "adverb-godot3.zip": (try_godot, ("godot3-server",)),
    "adverb-blender.zip": (try_blender, ()),
}
"""Parts of a release, how each is tried, and the programs that this needs."""


def main(dist: Path) -> int:
    """Try all parts; returns the exit status."""
    failures = 0
    with tempfile.TemporaryDirectory(prefix="try-dist") as work:
        place = Path(work)
        (place / "server").mkdir()
        programs = install(place / "server", next(dist.glob("adverb-[0-9]*.whl")))
        print("adverb wheel: installed; its first start compiles kernels", flush=True)
        with served(programs, place / "server") as server:
            shown = run(programs / "adverb", "pose", "reach", "--at", "x=-0.3,y=1.2,z=0.4", cwd=place,
                        NUMBA_CACHE_DIR=str(place / "server" / "cache"))  # fmt: skip
            print(f"adverb wheel: serves; adverb pose printed {len(shown.splitlines())} lines", flush=True)
            for number, (name, (attempt, needs)) in enumerate(PARTS.items()):
                if absent := [need for need in needs if shutil.which(need) is None]:
                    print(f"{name}: left out, without {' and '.join(absent)}", flush=True)
                    continue
                (place / str(number)).mkdir()
                try:
                    print(f"{name}: {attempt(dist, place / str(number), server)}", flush=True)
                except (Failed, StopIteration) as err:
                    failures += 1
                    print(f"{name}: FAILED\n{err}", flush=True)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "dist").resolve()))
