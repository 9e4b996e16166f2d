"""Targets that read files: motion files, verb.toml, archives of uploads, verb files.

Where a checksum or a container would refuse nearly all mutated bytes, the first byte of an input selects how the rest
is framed: as it is, or in a valid container.
"""

from __future__ import annotations

import io
import json
import shutil
import struct
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from service.upload import archive
from tests.service.upload.raw_zip import Row, raw_zip
from tests.verbs.clip_files import Bone, bvh_text, moving
from tests.verbs.gltf_files import Gltf, random_rotations
from tests.verbs.sources import arm_motion, arm_source
from verbs.authoring import source
from verbs.errors import ArtifactError, MotionFileError, SourceError, VerbError
from verbs.io import artifact, bvh, gltf, npz
from verbs.io.report import Marks, MotionFile
from verbs.runtime.evaluate import Evaluator

Run = Callable[[bytes], None]

GOLDEN = Path(__file__).parents[1] / "golden"
MEMORY = Path("/dev/shm")


@contextmanager
def folder() -> Iterator[Path]:
    """A new folder, in memory where there is one."""
    with tempfile.TemporaryDirectory(prefix="fuzz", dir=MEMORY if MEMORY.is_dir() else None) as name:
        yield Path(name)


def _check(file: MotionFile) -> None:
    """A motion that was accepted has finite numbers and unit rotations."""
    motion = file.motion
    assert np.isfinite(motion.root).all()
    assert np.isfinite(motion.skeleton.offsets).all()
    assert np.allclose(np.linalg.norm(motion.rotations, axis=-1), 1.0, atol=1e-6)


# ── motion files ─────────────────────────────────────────────────────────────────────────────────────────────────────


@contextmanager
def read_bvh() -> Iterator[Run]:
    """The bytes are a BVH file."""
    with folder() as place:

        def run(data: bytes) -> None:
            (place / "clip.bvh").write_bytes(data)
            with suppress(MotionFileError):
                _check(bvh.read_file(place / "clip.bvh"))

        yield run


def bvh_seeds() -> Iterator[bytes]:
    """Rigs with and without tips, several trees, moving joints."""
    angles, places = np.outer(np.arange(3.0), [10.0, 20.0, 30.0]), np.outer(np.arange(3.0), [0.1, 0.0, 0.2])
    root = Bone("Hips", -1, (0.0, 1.0, 0.0), moving("ZXY", angles, places))
    arm = Bone("Arm", 0, (0.0, 0.5, 0.0), moving("YXZ", angles), [(0.0, 0.2, 0.0)])
    still = Bone("Still", 0, (0.1, 0.0, 0.0), {})
    other = Bone("Other", -1, (0.0, 0.0, 0.0), moving("XYZ", angles))
    yield bvh_text([root, arm]).encode()
    yield bvh_text([root, arm, still]).encode()
    yield bvh_text([root, arm, other]).encode()
    yield bvh_text([other, Bone("Child", 0, (0.0, 1.0, 0.0), moving("XYZ", angles, places))]).encode()
    yield b"\xef\xbb\xbf" + bvh_text([root, arm]).replace("\n", "\r\n").encode()


@contextmanager
def read_gltf() -> Iterator[Run]:
    """0: a .glb file as it is; 1: a .gltf file; 2: JSON and, after a zero byte, the binary chunk of a .glb file."""
    with folder() as place:

        def run(data: bytes) -> None:
            kind, content = data[:1], data[1:]
            path = place / ("clip.gltf" if kind == b"1" else "clip.glb")
            path.write_bytes(_glb(*content.partition(b"\0")[::2]) if kind == b"2" else content)
            with suppress(MotionFileError):
                _check(gltf.read_file(path))

        yield run


def _glb(text: bytes, binary: bytes) -> bytes:
    text, binary = text + b" " * (-len(text) % 4), binary + bytes(-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def gltf_seeds() -> Iterator[bytes]:
    """Two joints with every way to write keys."""
    for mode, code, sparse, skin in (
        ("LINEAR", "f", False, False),
        ("STEP", "h", False, True),
        ("CUBICSPLINE", "f", False, False),
        ("LINEAR", "f", True, True),
    ):
        file = Gltf()
        joint = file.node("a")
        tip = file.node("b", joint, translation=[0.0, 1.0, 0.0])
        values = random_rotations(np.random.default_rng(0), 9 if mode == "CUBICSPLINE" else 3)
        clip = file.animation("turn")
        file.channel(clip, joint, "rotation", np.arange(3) / 8, values, mode, code=code)
        places = np.zeros((9 if mode == "CUBICSPLINE" else 3, 3))
        file.channel(clip, joint, "translation", np.arange(3) / 8, places, mode, sparse=sparse)
        if skin:
            file.skin([joint, tip])
        glb = file.glb()
        length = int.from_bytes(glb[12:16], "little")
        yield b"0" + glb
        yield b"1" + file.embedded().encode()
        yield b"2" + glb[20 : 20 + length] + b"\0" + glb[28 + length :]


_NAMES = (
    "joint_names", "parents", "offsets", "rotations", "rotation_matrices", "root_positions", "fps", "tip_parents",
    "tip_offsets", "contacts", "contact_names", "other",
)  # fmt: skip


@contextmanager
def read_npz() -> Iterator[Run]:
    """0: an archive as it is; 1: arrays in a valid archive, each as number of its name, length (u16), bytes."""
    with folder() as place:

        def run(data: bytes) -> None:
            path = place / "clip.npz"
            path.write_bytes(_archive_of(data[1:]) if data[:1] == b"1" else data[1:])
            with suppress(MotionFileError):
                _check(npz.read_file(path))

        yield run


def _archive_of(data: bytes) -> bytes:
    packed, at = io.BytesIO(), 0
    with zipfile.ZipFile(packed, "w") as opened:
        while at + 3 <= len(data):
            length = int.from_bytes(data[at + 1 : at + 3], "little")
            row = zipfile.ZipInfo(_NAMES[data[at] % len(_NAMES)] + ".npy")
            if row.filename not in opened.namelist():
                opened.writestr(row, data[at + 3 : at + 3 + length])
            at += 3 + length
    return packed.getvalue()


def npz_seeds() -> Iterator[bytes]:
    """A motion with quaternions, the same with matrices, each in both framings."""
    motion = arm_motion(0.3, 0.4, frames=3)
    matrices = {"rotation_matrices": np.tile(np.eye(3, dtype=np.float32), (3, 3, 1, 1))}
    with folder() as place:
        npz.write(motion, place / "a.npz", contacts=Marks(("Hand",), np.ones((3, 1))))
        yield b"0" + (place / "a.npz").read_bytes()
        for change in ({}, matrices):
            with np.load(place / "a.npz") as file:
                arrays = {name: file[name] for name in file.files if not (change and name == "rotations")} | change
            content = b""
            for name, array in arrays.items():
                part = io.BytesIO()
                np.lib.format.write_array(part, array, allow_pickle=False)
                content += struct.pack("<BH", _NAMES.index(name), len(part.getvalue())) + part.getvalue()
            yield b"1" + content


# ── sources and archives ─────────────────────────────────────────────────────────────────────────────────────────────


@contextmanager
def read_toml() -> Iterator[Run]:
    """The bytes are a verb.toml."""
    with folder() as place:

        def run(data: bytes) -> None:
            (place / "verb.toml").write_bytes(data)
            with suppress(SourceError):
                source.read(place)

        yield run


def toml_seeds() -> Iterator[bytes]:
    """A source with every key."""
    with folder() as place:
        arm = (arm_source(place / "arm") / "verb.toml").read_bytes()
    yield arm
    more = (
        b'description = "An arm"\nlooping = true\nclimbing = true\nsamples = 9\nroot = "Upper"\nchart = "affine"\n'
        b'rotations = "rotation_vector"\ntail = "constant"\nstretch_m = 0.01\nsimplices = [[0, 1, 2]]\n'
        b"contacts = true\ncolour = { red = 1, day = 2020-01-01T00:00:00Z }\n"
    )
    tables = (
        b'\n[units]\nlength = "cm"\ntime = "s"\nadverb_angle = "deg"\nup_axis = "+Z"\nforward_axis = "+Y"\n'
        b"[goal]\norigin = [0, 1, 0]\naxes = [[1, 0, 0], [0, 1, 0]]\n"
        b'[[contact]]\njoint = "Hand"\npart = "toe"\nintervals = [[0.1, 0.4]]\n'
        b'[[mend]]\nexample = "a"\nkind = "feet"\n[retarget]\nto = "a"\n'
    )
    yield more + arm
    yield more + arm + tables
    yield arm.replace(b'"a.bvh"', b'"a\\u0000.bvh"')
    yield arm.replace(b'name = "arm"', b'name = "arm"\nsamples = 0x' + b"f" * 4_000)
    yield arm.replace(b"[0.0,", b"[0x" + b"f" * 4_000 + b",")
    yield b"a" + b".a" * 4_000 + b" = 1"
    yield b"'a'" + b' . "a"' * 1_000 + b" = 1"
    yield b"a = " + b"[" * 4_000
    yield b"a = " + b"{a = " * 300 + b"1" + b"}" * 300
    yield arm.replace(b"[0.0,", b"[0x7fffffffffffffff,").replace(b'"a.bvh"', b'"a\\u0041\\n.bvh"')


@contextmanager
def unpack_zip() -> Iterator[Run]:
    """0: an archive as it is; 1: rows of an archive with valid lengths and checksums, see :func:`_zip_of`."""
    with folder() as place:
        count = 0

        def run(data: bytes) -> None:
            nonlocal count
            count += 1
            path, out = place / "upload.zip", place / f"out{count}"
            path.write_bytes(_zip_of(data[1:]) if data[:1] == b"1" else data[1:])
            out.mkdir()
            try:
                with suppress(SourceError):
                    assert archive.unpack_clips(path, out).is_relative_to(out)
                assert {each.name for each in place.iterdir()} == {out.name, path.name}
                for each in out.rglob("*"):
                    assert each.is_file() or each.is_dir()
                    assert not each.is_symlink()
            finally:
                shutil.rmtree(out)

        yield run


def _zip_of(data: bytes) -> bytes:
    """An archive of rows: method, mode (u16), length of name, length of content (u16), name, content."""
    rows, at = [], 0
    while at + 6 <= len(data) and len(rows) < 1_000:
        method, mode, name, content = struct.unpack_from("<BHBH", data, at)
        middle, end = at + 6 + name, at + 6 + name + content
        rows.append(Row(data[at + 6 : middle], data[middle:end], mode, method))
        at = end
    return raw_zip(rows)


def zip_seeds() -> Iterator[bytes]:
    """Sources in both framings: links, climbing names, files that are folders too, a bomb, many rows."""

    def rows(*names: bytes, mode: int = 0o100644, method: int = 0, content: bytes = b"x = 1") -> bytes:
        return b"".join(struct.pack("<BHBH", method, mode, len(name), len(content)) + name + content for name in names)

    several = rows(b"verb.toml", b"a.bvh", b"VERB.TOML", method=8)
    for text in (
        several,
        rows(b"a/verb.toml", b"a", b"a/b/c/d/e/f/g/h/i"),
        rows(b"../verb.toml") + rows(b"/etc/x", b"C:x", b"a\\b", b"x//y", b"./z"),
        rows(b"verb.toml", mode=0o120777),
        rows(b"verb.toml", b"__MACOSX/a", b"._b", b".DS_Store"),
        rows(*(b"%d.npz" % k for k in range(200)), content=b""),
        rows(b"verb.toml", method=8, content=bytes(60_000)),
        rows(b"verb.toml", method=12) + rows(b"a.bvh", method=14),
    ):
        yield b"1" + text
        yield b"0" + _zip_of(text)
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", method) as opened:
            opened.writestr("verb.toml", b"name = 'x'")
        yield b"0" + packed.getvalue()


# ── verb files ───────────────────────────────────────────────────────────────────────────────────────────────────────


@contextmanager
def load_artifact() -> Iterator[Run]:
    """0: a file as it is; 1: facts, zero byte, header of arrays, zero byte, changed numbers; the checksum is valid.

    A verb that is accepted gives a pose. Changed numbers are the place (u16, in 8 bytes) and 8 bytes each.
    """
    whole = (GOLDEN / "arm.v1.verb").read_bytes()
    header, body = _split(whole)
    arrays = {name: row for name, row in header.items() if name != "__metadata__"}
    with folder() as place:
        path = place / "x.verb"

        def run(data: bytes) -> None:
            if data[:1] == b"1":
                facts, _, rest = data[1:].partition(b"\0")
                text, _, changes = rest.partition(b"\0")
                _seal(path, facts, text or json.dumps(arrays).encode(), _changed(body, changes))
            else:
                path.write_bytes(data[1:])
            with suppress(ArtifactError):
                verb = artifact.load(path)
                with suppress(VerbError):
                    middle = {adverb.name: 0.5 * (adverb.minimum + adverb.maximum) for adverb in verb.adverbs}
                    Evaluator(verb).pose(middle, phase=0.5)

        run(b"0" + whole)  # compiles kernels
        yield run


def _split(whole: bytes) -> tuple[dict[str, object], bytes]:
    length = int.from_bytes(whole[:8], "little")
    return json.loads(whole[8 : 8 + length]), whole[8 + length :]


def _changed(body: bytes, changes: bytes) -> bytes:
    numbers = bytearray(body)
    for at in range(0, len(changes) - 9, 10):
        start = 8 * (int.from_bytes(changes[at : at + 2], "little") % (len(body) // 8))
        numbers[start : start + 8] = changes[at + 2 : at + 10]
    return bytes(numbers)


def _seal(path: Path, facts: bytes, arrays: bytes, body: bytes) -> None:
    """Write a file of these facts and arrays; its checksum is valid if they can be read at all."""

    def write(text: bytes) -> None:
        try:
            header = json.loads(arrays)
            header["__metadata__"] = {"adverb": text.decode()}
            head = json.dumps(header).encode()
        except (ValueError, TypeError, RecursionError):
            head = b'{"__metadata__": {"adverb": "{}"}}'
        head += b" " * (-len(head) % 8)
        path.write_bytes(len(head).to_bytes(8, "little") + head + body)

    write(facts)
    with suppress(ArtifactError, ValueError, RecursionError):
        found, read = artifact._map(path)
        read.pop("sha256", None)
        read["sha256"] = artifact._digest(found, read)
        write(json.dumps(read).encode())


def artifact_seeds() -> Iterator[bytes]:
    """The golden files as they are, and the first in parts."""
    for name in ("arm.v1.verb", "jump.v2.verb"):
        yield b"0" + (GOLDEN / name).read_bytes()
    header, _ = _split((GOLDEN / "arm.v1.verb").read_bytes())
    facts = json.loads(header.pop("__metadata__")["adverb"])  # type: ignore[index]
    del facts["sha256"]
    short = facts | {"provenance": {}, "quality": {}}
    yield b"1" + json.dumps(facts).encode()
    yield b"1" + json.dumps(short).encode()
    yield b"1" + json.dumps(short).encode() + b"\0" + json.dumps(header).encode()
    yield b"1" + json.dumps(short).encode() + b"\0\0" + struct.pack("<HdHq", 3, 0.5, 900, 2)
