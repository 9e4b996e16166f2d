"""Write archives of the clients that are no packages: ``python -m tools.dist [FOLDER]``, by default into ``dist``.

The same files give the same bytes: names are sorted, and times and modes are fixed.
"""

from __future__ import annotations

import io
import shutil
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path

from tools import godot3

__all__ = ["blender", "godot", "write", "zip_bytes"]

ROOT = Path(__file__).parents[1]
CLIENTS = ROOT / "clients"
TIME = (1980, 1, 1, 0, 0, 0)
"""The earliest that an archive can state."""


def zip_bytes(files: Mapping[str, bytes]) -> bytes:
    """An archive of files by path."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in sorted(files):
            info = zipfile.ZipInfo(name, TIME)
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(info, files[name])
    return stream.getvalue()


def godot() -> dict[str, bytes]:
    """The addon for Godot 4 with its demo."""
    found = _guide()
    for part in ("addons", "demo"):
        for path in sorted((CLIENTS / "godot" / part).rglob("*")):
            if path.is_file():
                found[path.relative_to(CLIENTS / "godot").as_posix()] = path.read_bytes()
    return found


def _guide() -> dict[str, bytes]:
    """Guide and licence of the Godot addon."""
    return {"addons/adverb/README.md": (CLIENTS / "godot" / "README.md").read_bytes(), **_licence("addons/adverb/")}


def blender() -> dict[str, bytes]:
    """The add-on for Blender, with its manifest at the top."""
    folder = CLIENTS / "blender" / "adverb_blender"
    found = {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.suffix in (".py", ".toml")}
    return {**found, "README.md": (CLIENTS / "blender" / "README.md").read_bytes(), **_licence("")}


def _licence(prefix: str) -> dict[str, bytes]:
    return {f"{prefix}LICENSE": (ROOT / "LICENSE").read_bytes()}


def write(folder: Path) -> None:
    """Write all archives, and the file of the C# client."""
    folder.mkdir(parents=True, exist_ok=True)
    addon3 = {name: content for name, content in godot3.files().items() if name != "project.godot"}
    archives = {
        "adverb-godot4.zip": godot(),
        "adverb-godot3.zip": {**addon3, **_guide()},
        "adverb-blender.zip": blender(),
    }
    for name, files in archives.items():
        (folder / name).write_bytes(zip_bytes(files))
    shutil.copyfile(CLIENTS / "csharp" / "Adverb.cs", folder / "Adverb.cs")


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "dist")
