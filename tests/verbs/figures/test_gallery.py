import json
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from verbs import library
from verbs.cli import app
from verbs.errors import VerbError
from verbs.io import artifact

pytest.importorskip("matplotlib")
pytest.importorskip("PIL")

from PIL import Image

from verbs.figures.gallery import gallery
from verbs.figures.sheet import PALETTE

NAMES = ["arm3_time.png", "arm3_x.png", "arm3_y.png", "arm3_grid.png"]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    stages = []
    out = tmp_path_factory.mktemp("gallery")
    paths = gallery([library.load("arm3"), library.load("reach")], out, progress=lambda *stage: stages.append(stage))
    return out, paths, stages


@pytest.fixture(scope="module")
def page(written):
    """The page as a tree: it is well-formed XML after its first line."""
    first, rest = (written[0] / "index.html").read_text(encoding="utf-8").split("\n", 1)
    assert first == "<!DOCTYPE html>"
    return ElementTree.fromstring(rest)


def test_every_strip_is_a_picture_of_readable_size_and_few_bytes(written):
    out, paths, _ = written
    assert [path.name for path in paths[:4]] == NAMES
    assert sorted(path.name for path in out.iterdir()) == sorted(path.name for path in paths)
    for path in paths[:-1]:
        with Image.open(path) as picture:
            assert 900 <= picture.width <= 1500, path
            assert 100 <= picture.height <= 2000, path
        assert path.stat().st_size < 250_000


def test_frames_are_drawn_at_the_cells_of_the_examples(written):
    """The arm's examples are at three of five rows and three of seven columns: nine frames, no more."""
    colour = tuple(int(PALETTE["boxed"][k : k + 2], 16) for k in (1, 3, 5))
    with Image.open(written[0] / "arm3_grid.png") as picture:
        pixels = picture.convert("RGB")
        width, height = pixels.size
        filled = [[_near(pixels.getpixel((x, y)), colour) for x in range(width)] for y in range(height)]
    columns = _runs([sum(row[x] for row in filled) > 30 for x in range(width)])
    rows = _runs([sum(row) > 30 for row in filled])
    assert (len(columns), len(rows)) == (3, 3)
    assert columns[0][0] > 0.05 * width
    assert columns[-1][1] > 0.95 * width


def _near(pixel, colour):
    return max(abs(a - b) for a, b in zip(pixel, colour, strict=True)) <= 1


def _runs(flags):
    """Pieces (first, last) of a row of truths."""
    starts = [k for k, flag in enumerate(flags) if flag and (k == 0 or not flags[k - 1])]
    ends = [k for k, flag in enumerate(flags) if flag and (k == len(flags) - 1 or not flags[k + 1])]
    return list(zip(starts, ends, strict=True))


def test_links_of_the_page_resolve_and_need_nothing_else(written, page):
    pictures = [image.get("src") for image in page.iter("img")]
    assert pictures == [path.name for path in written[1][:-1]]
    for image in page.iter("img"):
        with Image.open(written[0] / image.get("src")) as picture:
            assert picture.size == (int(image.get("width")), int(image.get("height")))
        assert image.get("alt")
    anchors = {section.get("id") for section in page.iter("section")}
    assert {link.get("href") for link in page.iter("a")} == {f"#{name}" for name in anchors}
    assert not list(page.iter("script"))
    assert not list(page.iter("link"))
    assert "http" not in (written[0] / "index.html").read_text(encoding="utf-8")


def test_the_page_states_adverbs_examples_error_and_command(page):
    text = {section.get("id"): "".join(section.itertext()) for section in page.iter("section")}
    reach = library.load("reach")
    assert reach.description in text["reach"]
    assert "−0.764 to 0.232 m" in text["reach"]
    assert "24 examples" in text["reach"]
    assert ", ".join(reach.examples) in text["reach"]
    assert "Measured error" in text["reach"]
    assert "adverb gallery reach" in text["reach"]


def test_pictures_are_the_same_in_every_run(written, tmp_path):
    gallery([library.load("arm3")], tmp_path)
    for name in NAMES:
        assert (tmp_path / name).read_bytes() == (written[0] / name).read_bytes()


def test_progress_ends_where_it_is_done(written):
    last = {stage: (done, total) for stage, done, total in written[2]}
    assert last == {"arm3": (4, 4), "reach": (5, 5)}


def test_two_verbs_of_one_name_have_files_of_their_own(tmp_path):
    paths = gallery([library.load("arm3")] * 2, tmp_path, sources=["a b.verb", "arm3"])
    assert len({path.name for path in paths}) == 9
    assert "adverb gallery 'a b.verb'" in ElementTree.fromstring(
        paths[-1].read_text(encoding="utf-8").split("\n", 1)[1]
    ).findtext(".//section/p/code")


def test_the_command_draws_names_and_files_and_prints_their_list(tmp_path):
    artifact.save(library.load("arm3"), tmp_path / "mine.verb")
    arguments = ["gallery", str(tmp_path / "mine.verb"), "-o", str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0
    assert json.loads(result.stdout) == [str(tmp_path / "out" / name) for name in [*NAMES, "index.html"]]


def test_an_unknown_verb_is_exit_code_1_and_writes_nothing(tmp_path):
    code = "from verbs.cli import main; main()"
    command = [sys.executable, "-c", code, "gallery", "arm3", "nothing", "-o", str(tmp_path / "out")]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout) == (1, "")
    assert found.stderr.startswith("error: unknown verb 'nothing'; known: arm3, board, ")
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(VerbError, match="file"):
        gallery([library.load("arm3")], tmp_path / "file")
