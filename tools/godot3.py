"""Write the addon for Godot 3: ``python -m tools.godot3 FOLDER``.

The sources in ``clients/godot/addons`` are for Godot 4. They use what both versions have; what remains are other names
(:data:`NAMES`), which are replaced, and the few files of ``clients/godot/godot3``, which are written by hand.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

__all__ = ["CLIENT", "files", "translate", "write"]

CLIENT = Path(__file__).parents[1] / "clients" / "godot"
ADDON = "addons/adverb"

NAMES = {
    r"\bRefCounted\b": "Reference",
    r"\bNode3D\b": "Spatial",
    r"\bSkeleton3D\b": "Skeleton",
    r"\bMeshInstance3D\b": "MeshInstance",
    r"\bTransform3D\b": "Transform",
    r"\bQuaternion\b": "Quat",
    r"\bPackedByteArray\b": "PoolByteArray",
    r"\bPackedStringArray\b": "PoolStringArray",
    r"\bPackedVector3Array\b": "PoolVector3Array",
    r"\bTYPE_FLOAT\b": "TYPE_REAL",
    r"\bto_utf8_buffer\(": "to_utf8(",
    r"\.rfind\(": ".find_last(",
    r"(?m)^@export ": "export ",
    r"(?m)^@tool$": "tool",
}
"""Names of Godot 4 as patterns, and those of Godot 3."""


def translate(source: str) -> str:
    """A script for Godot 4 as one for Godot 3."""
    for pattern, name in NAMES.items():
        source = re.sub(pattern, name, source)
    return source


def files() -> dict[str, bytes]:
    """Content of the addon and the demo for Godot 3, by path in the project."""
    found = {}
    for path in sorted(CLIENT.rglob("*")):
        name = path.relative_to(CLIENT).as_posix()
        if path.suffix == ".gd" and not name.startswith("godot3/"):
            found[name] = translate(path.read_text("utf-8")).encode()
        elif path.suffix == ".cfg":
            found[name] = path.read_bytes()
    for path in sorted((CLIENT / "godot3").rglob("*")):
        name = path.relative_to(CLIENT / "godot3").as_posix()
        if path.is_file():
            found[name if "/" in name or path.suffix != ".gd" else f"{ADDON}/{name}"] = path.read_bytes()
    return found


def write(folder: Path) -> None:
    """Write the files."""
    for name, content in files().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
