"""A figure of the user's own: a dropped GLB or VRM file performs, is corrected, and is kept."""

import base64
import math
import struct
import zlib

import httpx
import numpy as np
import pytest

from tests.strangers.vrm_files import avatar
from tests.verbs.mapping.rigs import remade
from verbs import library
from verbs.io import gltf_writer
from verbs.io.glb import GlbBuilder
from verbs.io.gltf_document import open_document
from verbs.kernels import fk
from verbs.mapping.mapper import Mapper
from verbs.mapping.mapping import open_mapping
from verbs.mapping.presets import preset
from verbs.motion import Motion
from verbs.runtime.evaluate import Evaluator

pytestmark = [pytest.mark.xdist_group("dashboard"), pytest.mark.slow]

DROP = """([content, name]) => {
  const files = new DataTransfer();
  files.items.add(new File([Uint8Array.from(atob(content), (c) => c.charCodeAt(0))], name));
  return files;
}"""


def drop(page, name, content):
    files = page.tab.evaluate_handle(DROP, [base64.b64encode(content).decode(), name])
    page.tab.dispatch_event("main.scene", "drop", {"dataTransfer": files})


def hero(tmp_path):
    """A GLB file: a skinned body of other proportions on Mixamo's joints, with a texture."""
    rig = remade(preset("mixamo"), scale=0.8, arms=1.1)
    motion = Motion(rig.skeleton, 30.0, np.tile(rig.origin, (2, 1)), np.stack([rig.rest, rig.rest]))
    path = tmp_path / "hero.glb"
    path.write_bytes(gltf_writer.dump(motion))
    document = open_document(path)
    builder = GlbBuilder.of(document.table, document.binary)
    row = builder.table["accessors"][builder.accessor(np.frombuffer(picture(), "<u1"))]
    builder.add("images", {"bufferView": row["bufferView"], "mimeType": "image/png"})
    builder.add("textures", {"source": 0})
    builder.table["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    builder.table["accessors"].pop()
    path.write_bytes(builder.content())
    return path


def picture():
    """A PNG of one pixel."""

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(b"\0\xff\xa0\x60"))
        + chunk(b"IEND", b"")
    )


def expected(page, path, phase):
    """Places of the joints of a file's figure at the page's goal, by the library."""
    evaluator = Evaluator(library.load("reach"))
    mapper = Mapper.of_verb(evaluator, open_mapping(str(path)))
    found = mapper.poses(evaluator.pose(page.state("adverb.view.goal"), phase=phase))
    skeleton = mapper.skeleton
    places = fk.forward(found.root, found.rotations, skeleton.parents, skeleton.offsets)[1][0]
    return dict(zip(skeleton.names, places.tolist(), strict=True))


def pause_at_goal(page):
    described = httpx.get(f"{page.service.url}/v1/verbs/reach").json()
    keytimes = dict(zip(described["keytime_names"], described["keytime_phases"], strict=True))
    phase = keytimes[described["measure"]["keytime"]]
    page.tab.get_by_role("button", name="Pause at goal").click()
    page.until(f"Math.abs(adverb.shown.main?.phase - {phase}) < 1e-3")
    page.until(  # the hand of the figure is on the handle, which is scaled as the figure
        "(({effector, goal}) => effector && goal && Math.hypot(...effector.map((e, k) => e - goal[k])) < 0.003)"
        "(adverb.drawn)"
    )
    return phase


def test_a_dropped_file_performs(page, tmp_path):
    path = hero(tmp_path)
    page.open(verb="reach")
    drop(page, "hero.glb", path.read_bytes())
    page.until("adverb.figure !== null")
    before = page.state("adverb.figure.places")
    page.until(f"Math.abs(adverb.figure.places['mixamorigRightHand'][1] - {before['mixamorigRightHand'][1]}) > 0.05")
    phase = pause_at_goal(page)
    page.until("adverb.figure.effector !== null && adverb.figure.effector < 0.002 && adverb.figure.feet < 0.002")
    places, wanted = page.state("adverb.figure.places"), expected(page, path, phase)
    for name, place in wanted.items():
        if "Hand" not in name or name.endswith("Hand"):  # three.js drops the colon of a name
            assert math.dist(places[name.replace(":", "")], place) < 0.015, name
    assert page.tab.get_by_text("hero.glb").is_visible()
    assert page.state("adverb.view.figure") == "hero.glb"


def test_a_vrm_file_in_a_turned_rest_pose_performs(page, tmp_path):
    path = tmp_path / "avatar.vrm"
    path.write_bytes(avatar(library.load("reach").skeleton, scale=1.2, limbs=0.9, turned=True))
    page.open(verb="reach")
    drop(page, "avatar.vrm", path.read_bytes())
    page.until("adverb.figure !== null")
    phase = pause_at_goal(page)
    page.until("adverb.figure.effector !== null && adverb.figure.effector < 0.002")
    places, wanted = page.state("adverb.figure.places"), expected(page, path, phase)
    for bone in ("rightHand", "leftFoot", "head", "rightLowerLeg"):
        assert math.dist(places[f"bone_{bone}"], wanted[f"bone {bone}"]) < 0.015, bone


def test_the_mapping_can_be_corrected_and_is_kept(page, tmp_path):
    page.open(verb="reach", playing="no")
    drop(page, "hero.glb", hero(tmp_path).read_bytes())
    page.until("adverb.figure !== null")
    moved = page.state("adverb.figure.moved")
    page.tab.locator(".own-figure summary").click()
    page.tab.get_by_label("Head", exact=True).select_option("")
    page.until(f"adverb.figure.moved === {moved - 1} && adverb.figure.isKept")
    page.tab.reload()
    page.until("document.documentElement.dataset.ready === 'true'")
    page.until(f"adverb.figure?.moved === {moved - 1}")
    page.tab.locator(".own-figure summary").click()
    page.tab.get_by_role("button", name="Match by names again").click()
    page.until(f"adverb.figure.moved === {moved}")
    page.tab.get_by_role("button", name="Remove").click()
    page.until("adverb.figure === null && adverb.view.figure === ''")


def test_a_figure_that_this_browser_does_not_have_is_named(page):
    page.open(verb="reach", figure="gone.glb")
    page.tab.get_by_text("gone.glb is not kept in this browser").wait_for()
    page.until("adverb.view.figure === ''")


def test_files_that_are_no_figures_are_refused(page):
    page.open(verb="reach")
    drop(page, "notes.txt", b"hello")
    page.tab.get_by_text("Drop a GLB or VRM file of a figure here").wait_for()
    drop(page, "broken.glb", b"glTF")
    page.tab.get_by_text("cannot be read").wait_for()
    assert page.state("adverb.figure") is None
