"""Uploads are read in a process of their own, forked or spawned, whatever they contain."""

import asyncio
import io
import zipfile
from pathlib import Path

import pytest

from service.errors import BadUpload
from service.upload.archive import unpack
from service.upload.builder import Builder
from service.upload.spawned import Spawned
from tests.service.upload.raw_zip import Row, raw_zip
from tests.verbs.sources import arm_source
from tests.warm import Sandboxes
from verbs import library
from verbs.authoring.fit import build
from verbs.errors import SourceError
from verbs.io import artifact


def zipped(path, files):
    """A zip of names and contents."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def contents(folder, prefix=""):
    return {prefix + file.name: file.read_bytes() for file in sorted(Path(folder).iterdir())}


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return arm_source(tmp_path_factory.mktemp("building") / "arm")


@pytest.fixture(scope="module")
def builder():
    """Builds in sandboxes that the warm parent forks."""
    with asyncio.Runner() as runner:
        made = Builder(Sandboxes())
        yield lambda upload, result: runner.run(made.make(upload, result))


@pytest.mark.parametrize("prefix", ["", "arm/"])
def test_a_zip_of_a_source_is_built_as_it_would_be_here(builder, source, tmp_path, prefix):
    upload = zipped(tmp_path / "arm.zip", {**contents(source, prefix), "__MACOSX/._verb.toml": b"x"})
    made = builder(upload, tmp_path / "arm.verb")
    artifact.save(build(source).verb, tmp_path / "here.verb")
    assert made.verb == "arm"
    assert artifact.load(tmp_path / "arm.verb").values.tolist() == artifact.load(tmp_path / "here.verb").values.tolist()
    assert (tmp_path / "arm.verb").read_bytes() == (tmp_path / "here.verb").read_bytes()
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []


def test_an_artifact_is_checked_and_kept_as_it_is(builder, tmp_path):
    upload = tmp_path / "upload"
    upload.write_bytes(Path(library.__file__).with_name("arm3.verb").read_bytes())
    made = builder(upload, tmp_path / "out.verb")
    assert made.verb == "arm3"
    assert (tmp_path / "out.verb").read_bytes() == upload.read_bytes()


def test_a_spawned_sandbox_answers_the_same(builder, source, tmp_path):
    good, bad = zipped(tmp_path / "arm.zip", contents(source)), tmp_path / "upload"
    bad.write_bytes(b"noise" * 100)

    async def both():
        sandboxes = Spawned()
        try:
            made = await Builder(sandboxes).make(good, tmp_path / "spawned.verb")
            with pytest.raises(BadUpload) as wrong:
                await Builder(sandboxes).make(bad, tmp_path / "out.verb")
        finally:
            await sandboxes.close()
        return made, wrong.value.detail

    made, detail = asyncio.run(both())
    assert made == builder(good, tmp_path / "forked.verb")
    assert (tmp_path / "spawned.verb").read_bytes() == (tmp_path / "forked.verb").read_bytes()
    with pytest.raises(BadUpload) as wrong:
        builder(bad, tmp_path / "out.verb")
    assert wrong.value.detail == detail


def _without_keytimes(source):
    text = (Path(source) / "verb.toml").read_text().replace("keytimes", "keytimez")
    return {**contents(source), "verb.toml": text}


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is 0 bytes long"),
        (b"noise" * 100, "is not a safetensors file"),
        (b"PK\x03\x04 broken", "cannot be unpacked"),
        ({"readme.txt": b"hello"}, "one verb.toml; it holds none"),
        ({"a/verb.toml": b"", "b/verb.toml": b""}, "it holds several"),
        ({"verb.toml": b"name = 3"}, "0 [[adverb]] tables"),
        ({"verb.toml": b"name = 'x'\n\xff"}, ""),
        ({"../verb.toml": b"x"}, "would lie outside"),
        ({"/etc/verb.toml": b"x"}, "would lie outside"),
    ],
)
def test_invalid_uploads_are_refused_with_the_reason(builder, tmp_path, content, problem):
    upload = tmp_path / "upload"
    if isinstance(content, dict):
        zipped(upload, content)
    else:
        upload.write_bytes(content)
    with pytest.raises(BadUpload) as wrong:
        builder(upload, tmp_path / "out.verb")
    assert problem in wrong.value.detail
    assert str(tmp_path) not in wrong.value.detail
    assert not (tmp_path / "out.verb").exists()


def test_a_mistake_in_a_source_is_named(builder, source, tmp_path):
    upload = zipped(tmp_path / "arm.zip", _without_keytimes(source))
    with pytest.raises(BadUpload, match="keytimes"):
        builder(upload, tmp_path / "out.verb")


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(9):
            archive.writestr(f"{number}.bvh", bytes(64 * 1024 * 1024))
    (tmp_path / "bomb.zip").write_bytes(bomb.getvalue())
    (tmp_path / "out").mkdir()
    with pytest.raises(SourceError, match="at most"):
        unpack(tmp_path / "bomb.zip", tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())


def damaged(at, value):
    """A zip of one file, of which some bytes of the headers or of the content are others."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("verb.toml", b"name = 'x'" * 50)
    content = bytearray(packed.getvalue())
    central = content.rindex(b"PK\x01\x02")
    for start in (at, central + at + 2) if at < 30 else (at,):
        content[start : start + len(value)] = value
    return bytes(content)


@pytest.mark.parametrize(
    "content",
    [damaged(6, b"\x01\x00"), damaged(39, b"\xff\xff\xff\xff")],
    ids=["password", "corrupt data"],
)
def test_archives_that_cannot_be_unpacked_are_refused(tmp_path, content):
    (tmp_path / "broken.zip").write_bytes(content)
    (tmp_path / "out").mkdir()
    with pytest.raises(SourceError, match="cannot be unpacked"):
        unpack(tmp_path / "broken.zip", tmp_path / "out")


def test_links_are_refused(tmp_path):
    row = zipfile.ZipInfo("verb.toml")
    row.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "link.zip", "w") as archive:
        archive.writestr(row, "/etc/passwd")
    (tmp_path / "out").mkdir()
    with pytest.raises(SourceError, match="is a link"):
        unpack(tmp_path / "link.zip", tmp_path / "out")


@pytest.mark.parametrize("name", [b"", b"."])
def test_files_without_a_name_are_refused(tmp_path, name):
    (tmp_path / "unnamed.zip").write_bytes(raw_zip([Row(b"verb.toml"), Row(name)]))
    (tmp_path / "out").mkdir()
    with pytest.raises(SourceError, match="a file without a name"):
        unpack(tmp_path / "unnamed.zip", tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, 97])
def test_compressions_without_a_bound_of_memory_are_refused(tmp_path, method):
    (tmp_path / "other.zip").write_bytes(raw_zip([Row(b"verb.toml", b"name = 'x'", method=method)]))
    (tmp_path / "out").mkdir()
    with pytest.raises(SourceError, match="another method than deflate"):
        unpack(tmp_path / "other.zip", tmp_path / "out")


def test_an_archive_of_100_000_files_is_refused(tmp_path):
    (tmp_path / "many.zip").write_bytes(raw_zip(Row(b"%d.bvh" % number) for number in range(100_000)))
    (tmp_path / "out").mkdir()
    with pytest.raises(SourceError, match="holds 100000 files"):
        unpack(tmp_path / "many.zip", tmp_path / "out")


def test_real_capture_is_built(builder, mocap, tmp_path):
    upload = zipped(tmp_path / "reach.zip", contents(mocap / "reach"))
    assert builder(upload, tmp_path / "out.verb").verb == "reach"
    assert len(artifact.load(tmp_path / "out.verb").examples) == 35
