"""glTF files of every kind that is read, and a plain evaluator of them by matrices; shares nothing with the reader."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np

from tests.verbs.clip_files import BODY, TIPS

TYPES = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
WIDTHS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


class Gltf:
    """A file that grows by nodes, skins and animations, and is written in one of three layouts."""

    def __init__(self) -> None:
        self.table: dict = {"asset": {"version": "2.0"}, "nodes": [], "accessors": [], "bufferViews": []}
        self.data = bytearray()

    # --- parts -------------------------------------------------------------------------------------------------

    def node(self, name: str | None = None, parent: int | None = None, **more) -> int:
        """Add a node; returns its index."""
        self.table["nodes"].append(({} if name is None else {"name": name}) | more)
        index = len(self.table["nodes"]) - 1
        if parent is not None:
            self.table["nodes"][parent].setdefault("children", []).append(index)
        return index

    def view(self, content: bytes, stride: int = 0) -> int:
        """Add a bufferView of bytes, aligned."""
        self.data.extend(b"\0" * (-len(self.data) % 4))
        row = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content)}
        self.data.extend(content)
        self.table["bufferViews"].append(row | ({"byteStride": stride} if stride else {}))
        return len(self.table["bufferViews"]) - 1

    def accessor(self, values, code: str = "f", *, stride: int = 0, sparse: bool = False) -> int:
        """Add an accessor of values (n,) or (n, width); integers are normalised, ``sparse`` has no dense part."""
        rows = np.atleast_2d(np.asarray(values, float).T).T
        if code != "f":
            rows = np.round(rows * np.iinfo(np.dtype(code)).max)
        stored = rows.astype(np.dtype(code).newbyteorder("<"))
        size = stored.itemsize * stored.shape[1]
        row = {"componentType": TYPES[code], "count": len(stored), "type": WIDTHS[stored.shape[1]]}
        if code != "f":
            row["normalized"] = True
        if sparse:
            indices = np.arange(len(stored)).astype("<u2")
            row["sparse"] = {
                "count": len(stored),
                "indices": {"bufferView": self.view(indices.tobytes()), "componentType": TYPES["H"]},
                "values": {"bufferView": self.view(stored.tobytes())},
            }
        else:
            step = max(stride, size)
            content = b"".join(line.tobytes().ljust(step, b"\xee") for line in stored)
            row["bufferView"] = self.view(content, stride)
        self.table["accessors"].append(row)
        return len(self.table["accessors"]) - 1

    def channel(self, animation: dict, node: int, path: str, times, values, mode: str = "LINEAR", **how) -> None:
        """Add a channel with a sampler of its own to an animation; ``how`` is for the accessor of its values."""
        values = np.asarray(values, float)
        flat = values.reshape(-1, values.shape[-1])
        sampler = {"input": self.accessor(times), "output": self.accessor(flat, **how), "interpolation": mode}
        animation.setdefault("samplers", []).append(sampler)
        target = {"sampler": len(animation["samplers"]) - 1, "target": {"node": node, "path": path}}
        animation.setdefault("channels", []).append(target)

    def animation(self, name: str | None = None) -> dict:
        """Add an animation; returns its row."""
        self.table.setdefault("animations", []).append({} if name is None else {"name": name})
        return self.table["animations"][-1]

    def skin(self, joints: list[int]) -> None:
        """Add a skin, with a mesh-less node that wears it left out."""
        self.table.setdefault("skins", []).append({"joints": joints})

    # --- layouts -----------------------------------------------------------------------------------------------

    def glb(self) -> bytes:
        """A binary file."""
        scene = self._scene({"byteLength": len(self.data)})
        text = json.dumps(scene).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.data) + b"\0" * (-len(self.data) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
        return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks

    def embedded(self) -> str:
        """Text with the buffer in it."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(self.data)).decode()
        return json.dumps(self._scene({"byteLength": len(self.data), "uri": uri}))

    def write(self, path: Path) -> Path:
        """Write ``.glb``, or ``.gltf`` with a ``.bin`` beside it; returns the path."""
        if path.suffix == ".glb":
            path.write_bytes(self.glb())
        else:
            (path.parent / f"{path.stem} data.bin").write_bytes(bytes(self.data))
            uri = f"{path.stem}%20data.bin"
            path.write_text(json.dumps(self._scene({"byteLength": len(self.data), "uri": uri})))
        return path

    def _scene(self, buffer: dict) -> dict:
        children = {child for node in self.table["nodes"] for child in node.get("children", [])}
        roots = [k for k in range(len(self.table["nodes"])) if k not in children]
        return self.table | {"buffers": [buffer], "scene": 0, "scenes": [{"nodes": roots}]}

    # --- evaluation --------------------------------------------------------------------------------------------

    def positions(self, times, clip: int = 0) -> dict[str, np.ndarray]:
        """Global positions (F, 3) of all nodes by name, at times in seconds, by 4 × 4 matrices."""
        tracks = {}
        for channel in self.table["animations"][clip]["channels"]:
            sampler = self.table["animations"][clip]["samplers"][channel["sampler"]]
            target = channel["target"]
            track = self._values(sampler["input"])[:, 0], self._values(sampler["output"]), sampler["interpolation"]
            tracks[target["node"], target["path"]] = track
        found: dict[str, list[np.ndarray]] = {}
        parents = {child: k for k, node in enumerate(self.table["nodes"]) for child in node.get("children", [])}
        for time in times:
            for index, node in enumerate(self.table["nodes"]):
                matrix, at = np.eye(4), index
                while at is not None:
                    matrix = self._local(at, tracks, time) @ matrix
                    at = parents.get(at)
                found.setdefault(node.get("name", f"nodes[{index}]"), []).append(matrix[:3, 3])
        return {name: np.array(rows) for name, rows in found.items()}

    def _local(self, index: int, tracks: dict, time: float) -> np.ndarray:
        node = self.table["nodes"][index]
        if "matrix" in node:
            return np.array(node["matrix"], float).reshape(4, 4).T
        parts = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
        for path, usual in parts.items():
            parts[path] = at_time(*tracks[index, path], time) if (index, path) in tracks else node.get(path, usual)
        x, y, z, w = np.asarray(parts["rotation"], float) / np.linalg.norm(parts["rotation"])
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        matrix = np.eye(4)
        matrix[:3, :3] = turn * np.asarray(parts["scale"], float)
        matrix[:3, 3] = parts["translation"]
        return matrix

    def _values(self, index: int) -> np.ndarray:
        row = self.table["accessors"][index]
        code = next(code for code, number in TYPES.items() if number == row["componentType"])
        width = next(width for width, name in WIDTHS.items() if name == row["type"])
        where = row["sparse"]["values"] if "sparse" in row else row
        view = self.table["bufferViews"][where["bufferView"]]
        size = struct.calcsize(code) * width
        step = view.get("byteStride", size)
        lines = [
            struct.unpack_from(f"<{width}{code}", self.data, view["byteOffset"] + k * step) for k in range(row["count"])
        ]
        values = np.array(lines, float)
        return np.maximum(values / np.iinfo(np.dtype(code)).max, -1.0) if row.get("normalized") else values


def at_time(times, values, mode: str, time: float) -> np.ndarray:
    """The value of a sampler at a time, as the specification's appendix C states it."""
    keys = values.reshape(len(times), 3, -1)[:, 1] if mode == "CUBICSPLINE" else values
    if time <= times[0] or time >= times[-1]:
        return keys[0 if time <= times[0] else -1]
    k = max(i for i, at in enumerate(times) if at <= time)
    if mode == "STEP":
        return keys[k]
    step = times[k + 1] - times[k]
    t = (time - times[k]) / step
    if mode == "CUBICSPLINE":
        triples = values.reshape(len(times), 3, -1)
        return (
            (2 * t**3 - 3 * t**2 + 1) * triples[k, 1]
            + step * (t**3 - 2 * t**2 + t) * triples[k, 2]
            + (-2 * t**3 + 3 * t**2) * triples[k + 1, 1]
            + step * (t**3 - t**2) * triples[k + 1, 0]
        )
    a, b = keys[k], keys[k + 1]
    if len(a) != 4:
        return (1 - t) * a + t * b
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    dot = float(a @ b)
    b, dot = (b, dot) if dot >= 0 else (-b, -dot)
    angle = np.arccos(min(dot, 1.0))
    sine = np.sin(angle) if angle > 1e-6 else 0.0
    return (np.sin((1 - t) * angle) * a + np.sin(t * angle) * b) / sine if sine else a + t * (b - a)


def random_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """Smooth unit quaternions (count, 4) in float32 precision."""
    start, rate = rng.normal(size=4), rng.normal(size=4)
    rows = start + np.linspace(0, 1.0, count)[:, None] * rate
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32).astype(float)


def body_file(
    mode: str = "LINEAR", *, frames: int = 16, fps: float = 32.0, seed: int = 0, above: bool = True, skin: bool = True
) -> Gltf:
    """A human body in centimetres under a node that turns +Z up into +Y up, animated by one clip, ``walk``."""
    rng, file = np.random.default_rng(seed), Gltf()
    armature = None
    if above:
        half = float(np.sqrt(0.5))
        top = file.node("Z_UP", rotation=[-half, 0.0, 0.0, half], translation=[0.0, 0.1, 0.0])
        armature = file.node("Armature", top, scale=[0.01, 0.01, 0.01])
    joints: dict[str, int] = {}
    for name, parent, offset in BODY:
        place = [100.0 * value if above else value for value in offset]
        joints[name] = file.node(name, armature if parent is None else joints[parent], translation=place)
    for name, offset in TIPS:
        file.node(f"{name}_end", joints[name], translation=[100.0 * value if above else value for value in offset])
    file.node("Surface", armature, mesh=0)
    file.table["meshes"] = [{"primitives": [{"attributes": {"POSITION": file.accessor(np.zeros((3, 3)))}}]}]
    if skin:
        file.skin(list(joints.values()))
    clip, times = file.animation("walk"), np.arange(frames) / fps
    for name, node in joints.items():
        keys = random_rotations(rng, frames)
        file.channel(clip, node, "rotation", times, with_tangents(rng, keys, mode), mode)
        if name == "Hips":
            place = np.linspace([0, -20, 90], [5, -120, 95], frames) * (1.0 if above else 0.01)
            file.channel(clip, node, "translation", times, with_tangents(rng, place, mode), mode)
    return file


def with_tangents(rng: np.random.Generator, values: np.ndarray, mode: str) -> np.ndarray:
    """Values with random tangents beside them, where the mode has tangents."""
    if mode != "CUBICSPLINE":
        return values
    tangents = 0.5 * rng.normal(size=(2, *values.shape)) * np.abs(values).max()
    return np.stack([tangents[0], values, tangents[1]], axis=1)
