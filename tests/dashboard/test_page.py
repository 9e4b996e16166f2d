"""User tasks on the dashboard, in a real browser against a real server."""

import io
import math
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import httpx
import numpy as np
import pytest

from tests.dashboard.conftest import PATIENCE_S, PROJECT, opened
from verbs import library
from verbs.io import motion_files

pytestmark = [pytest.mark.xdist_group("dashboard"), pytest.mark.slow]

TABS = ["Verb", "Quality", "Versions", "Service", "Upload"]


def drag(page, by, steps=12):
    """Drag the goal handle by some pixels."""
    x, y = page.state("adverb.drawn.handle")
    mouse = page.tab.mouse
    mouse.move(x, y)
    mouse.down()
    for step in range(1, steps + 1):
        mouse.move(x + by[0] * step / steps, y + by[1] * step / steps)
        page.tab.wait_for_timeout(20)
    mouse.up()


def distance(a, b):
    return math.dist(a, b)


@pytest.mark.parametrize(("verb", "by"), [("arm3", (-30, -40)), ("board", (-25, -30)), ("reach", (30, -35))])
def test_a_dragged_goal_is_reached(page, verb, by):
    page.open(verb=verb)
    before = page.state("adverb.view.goal")
    page.tab.get_by_role("button", name="Pause at goal").click()
    page.until("!adverb.view.playing && Math.abs(adverb.shown.main?.phase - adverb.view.phase) < 1e-3")
    drag(page, by)
    goal = page.state("adverb.view.goal")
    assert goal != before
    page.until(
        "(({effector, goal}) => effector && goal && Math.hypot(...effector.map((e, k) => e - goal[k])) < 0.002)"
        "(adverb.drawn)"
    )
    assert page.state("adverb.shown.main?.error") < 1e-3
    phase = page.state("adverb.view.phase")
    request = {"adverbs": goal, "phase": phase, "space": "global"}
    pose = httpx.post(f"{page.service.url}/v1/verbs/{verb}/pose", json=request).json()
    described = httpx.get(f"{page.service.url}/v1/verbs/{verb}").json()
    wrist = pose["positions"][described["skeleton"]["names"].index(described["measure"]["effector"])]
    assert pose["error"] < 1e-6
    assert distance(wrist, page.state("adverb.drawn.effector")) < 0.005


def test_a_slider_moves_the_goal(page):
    page.open(verb="reach", playing="no")
    slider = page.tab.get_by_role("slider", name="x, m").first
    slider.focus()
    before = page.state("adverb.view.goal.x")
    for _ in range(5):
        page.tab.keyboard.press("ArrowRight")
    after = page.state("adverb.view.goal.x")
    assert after > before
    page.until("adverb.drawn.goal !== null")
    page.until(f"Math.abs(adverb.drawn.goal[0] - {after}) < 1e-6")


def test_methods_can_be_switched(page):
    page.open(verb="arm3")
    method = page.tab.locator("header label", has_text="Method").locator("select")
    method.select_option("rbf")
    page.until("adverb.shown.main?.method === 'rbf' && adverb.shown.main?.error > 1e-3")
    method.select_option("")
    page.until("adverb.shown.main?.method === 'corrected' && adverb.shown.main?.error < 1e-6")


def test_two_methods_are_compared(page):
    page.open(verb="arm3")
    page.tab.get_by_label("Compare with").select_option("method:rbf")
    page.until("adverb.shown.comparison && adverb.shown.comparison.method === 'rbf'")
    assert page.state("adverb.shown.main?.method") == "corrected"


def test_a_refinement_publishes_a_version(page):
    page.open(verb="arm3", panel="quality", method="refined")
    page.tab.get_by_role("tab", name="Quality").click()
    assert page.tab.get_by_label("Refine for").input_value() == "quality"
    assert not page.tab.get_by_label("Target error, %").is_visible()
    page.tab.get_by_label("Refine for").select_option("error")
    page.tab.get_by_label("Target error, %").fill("3")
    page.tab.get_by_label("Max. pseudo-examples").fill("30")
    page.tab.get_by_role("button", name="Start", exact=True).click()
    page.until("adverb.shown.main?.version === 2", timeout_s=180)
    page.tab.get_by_text("Published as version 2").first.wait_for()
    page.tab.get_by_role("tab", name="Versions").click()
    page.tab.get_by_role("button", name="Roll back to v1").click()
    page.until("adverb.shown.main?.version === 1")


def test_the_worst_goals_of_a_refinement_are_played_before_and_after(page):
    page.open(verb="reach", panel="quality")
    page.tab.get_by_role("tab", name="Quality").click()
    page.tab.get_by_label("Max. pseudo-examples").fill("3")
    page.tab.get_by_role("button", name="Start", exact=True).click()
    page.until("adverb.shown.main?.version === 2", timeout_s=180)
    page.tab.get_by_text("Peak acceleration, p95").first.wait_for()
    page.tab.get_by_role("button", name="Play x").first.click()
    page.until("adverb.shown.comparison?.version === 1 && adverb.shown.main?.method === 'corrected'")


def test_poses_of_a_crowd_of_200_are_streamed_at_30_fps(page):
    page.open(verb="reach", crowd="200", crowdPoses="yes")
    page.until("adverb.shown.main?.count === 200")
    page.until("adverb.stats?.messagesPerS >= 30 && adverb.stats.posesPerS >= 30 * 200")


def test_a_crowd_moves_with_few_records(page):
    """Beside the steered character, which is streamed as poses."""
    page.open(verb="walk", crowd="200")
    page.until("adverb.shown.main?.count === 200")
    page.until("adverb.stats?.messagesPerS >= 15 && adverb.stats.posesPerS < 3 * adverb.stats.messagesPerS + 200")
    before = page.state("adverb.drawn.frames")
    page.until(f"adverb.drawn.frames > {before} + 10")
    page.tab.get_by_label("Crowd as poses").check()
    page.until("adverb.stats.posesPerS > 20 * 200 && adverb.shown.main?.count === 200")


def test_the_page_reconnects_to_a_restarted_server(page):
    page.open(verb="reach")
    page.service.kill()
    page.until("adverb.connection !== 'open'")
    page.tab.get_by_text("No connection to the server").first.wait_for()
    page.service.start()
    page.until("adverb.connection === 'open'")
    frames = page.state("adverb.drawn.frames")
    page.until(f"adverb.drawn.frames > {frames} + 10")
    page.ignore("net::ERR", "503")


def test_an_invalid_zip_shows_the_problem(page):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("wave/verb.toml", 'name = "wave"\n')
    page.open(verb="reach")
    page.tab.get_by_role("tab", name="Upload").click()
    page.tab.locator("input[type=file]").first.set_input_files(
        {"name": "wave.zip", "mimeType": "application/zip", "buffer": packed.getvalue()}
    )
    page.tab.get_by_text("verb.toml").first.wait_for()
    headers = {"Content-Type": "application/zip"}
    problem = httpx.post(
        f"{page.service.url}/v1/verbs", content=packed.getvalue(), headers=headers, timeout=PATIENCE_S
    ).json()
    page.tab.get_by_text(problem["detail"]).first.wait_for()
    page.ignore("422")


def source_folder(parent, name):
    """A copy of the source of `arm3` under another name."""
    folder = parent / name
    shutil.copytree(Path(library.__file__).parent / "arm3", folder)
    source = folder / "verb.toml"
    source.write_text(source.read_text().replace('name = "arm3"', f'name = "{name}"', 1))
    return folder


def test_a_chosen_folder_is_built_and_opened(page, tmp_path):
    folder = source_folder(tmp_path, "wave")
    (folder / ".DS_Store").write_bytes(b"hidden")
    page.open(verb="reach")
    page.tab.get_by_role("tab", name="Upload").click()
    page.tab.locator("input[webkitdirectory]").set_input_files(folder)
    page.tab.get_by_role("button", name="Open").click()
    page.until("adverb.view.verb === 'wave' && adverb.shown.main?.version === 1")


def test_a_second_upload_waits_for_the_first(page, tmp_path):
    page.open(verb="reach")
    page.tab.get_by_role("tab", name="Upload").click()
    for name in ("first", "second"):
        page.tab.locator("input[webkitdirectory]").set_input_files(source_folder(tmp_path, name))
    page.tab.get_by_text("second.zip is queued").wait_for()
    page.tab.get_by_text("Published first v1").wait_for()
    page.tab.get_by_text("Published second v1").wait_for()


def test_an_existing_verb_is_replaced_only_after_confirmation(page, tmp_path):
    page.open(verb="reach")
    page.tab.get_by_role("tab", name="Upload").click()
    folder = source_folder(tmp_path, "twice")
    choose = page.tab.locator("input[webkitdirectory]")
    choose.set_input_files(folder)
    page.tab.get_by_text("Published twice v1").wait_for()
    choose.set_input_files(folder)
    page.tab.get_by_role("button", name="Cancel").click()
    source = folder / "verb.toml"
    source.write_text(source.read_text().replace('description = "', 'description = "Changed: ', 1))
    choose.set_input_files(folder)
    page.tab.get_by_role("button", name="Publish as v2").click()
    page.tab.get_by_text("Published twice v2").wait_for()


def test_a_deleted_verb_leaves_the_menu_and_the_page_leaves_it(page, tmp_path):
    page.open(verb="reach")
    page.tab.get_by_role("tab", name="Upload").click()
    page.tab.locator("input[webkitdirectory]").set_input_files(source_folder(tmp_path, "gone"))
    page.tab.get_by_role("button", name="Open").click()
    page.until("adverb.shown.main?.verb === 'gone'")
    httpx.delete(f"{page.service.url}/v1/verbs/gone", timeout=PATIENCE_S).raise_for_status()
    page.tab.get_by_text("Verb “gone” was deleted.").wait_for()
    page.until("adverb.shown.main?.verb === 'reach'")
    assert "gone" not in page.tab.get_by_role("combobox", name="Verb").locator("option").all_inner_texts()
    page.ignore("404")


def test_back_and_forward_restore_verb_and_tab(page):
    page.open(verb="reach", playing="no", phase="0.3")
    entries = page.tab.evaluate("history.length")
    page.tab.get_by_role("slider", name="x, m").first.focus()
    page.tab.keyboard.press("ArrowRight")
    before = page.state("adverb.view")
    page.tab.get_by_role("combobox", name="Verb").select_option("arm3")
    page.until("adverb.shown.main?.verb === 'arm3'")
    page.tab.get_by_role("tab", name="Versions").click()
    assert page.tab.evaluate("history.length") == entries + 2
    page.tab.go_back()
    page.until("adverb.view.verb === 'arm3' && adverb.view.panel === 'verb'")
    page.tab.go_back()
    page.until("adverb.view.verb === 'reach' && adverb.shown.main?.verb === 'reach'")
    assert page.state("adverb.view") == before
    page.tab.go_forward()
    page.until("adverb.view.verb === 'arm3' && adverb.shown.main?.verb === 'arm3'")


def test_the_whole_motion_is_in_the_picture(page):
    page.tab.set_viewport_size({"width": 1280, "height": 720})
    for verb in ("arm3", "board", "reach", "jump", "kick"):
        page.open(verb=verb, playing="no")
        wide, high = page.tab.evaluate("[innerWidth - 320, innerHeight]")
        for phase in (0.0, 0.25, 0.5, 0.75, 1.0):
            page.tab.get_by_role("slider", name="Phase").fill(str(phase))
            page.until(f"Math.abs(adverb.shown.main?.phase - {phase}) < 1e-3")
            frames = page.state("adverb.drawn.frames")
            page.until(f"adverb.drawn.frames > {frames} && adverb.drawn.figure !== null")
            left, top, right, bottom = page.state("adverb.drawn.figure")
            assert min(left, top, wide - right, high - bottom) >= 0, (verb, phase)


def test_a_figure_outside_the_picture_can_be_found(page):
    page.open(verb="reach", follow="no", camera="0,1,5,0,1,9")
    page.tab.get_by_role("button", name="Find figure").click()
    page.until("adverb.drawn.figure && adverb.drawn.figure[0] > 0")
    page.tab.get_by_role("button", name="Find figure").wait_for(state="hidden")


def test_the_readout_shows_the_live_distance_and_the_prediction(page):
    page.open(verb="reach", playing="no", phase="0.02")
    page.tab.get_by_text("Will reach the goal at apex").wait_for()
    page.until("adverb.drawn.effector && adverb.drawn.goal")
    readout = page.tab.get_by_role("region", name="Goal error")
    far = page.state("Math.hypot(...adverb.drawn.effector.map((e, k) => e - adverb.drawn.goal[k]))")
    assert far > 0.1
    readout.get_by_text(f"{1000 * far:.0f} mm").wait_for()
    page.tab.get_by_role("button", name="Pause at goal").click()
    readout.get_by_text("Goal reached").wait_for()


def test_a_folder_without_clips_is_not_uploaded(page, tmp_path):
    (tmp_path / "notes.txt").write_text("nothing moves here")
    page.open(verb="reach")
    page.tab.get_by_role("tab", name="Upload").click()
    page.tab.locator("input[webkitdirectory]").set_input_files(tmp_path)
    page.tab.get_by_text("No clips found").wait_for()


def test_a_link_reopens_the_same_view(page):
    page.open(verb="board", playing="no", phase="0.3", method="rbf", maps="rbf,knn")
    page.tab.keyboard.press("ArrowRight")
    view = page.state("adverb.view")
    assert (view["verb"], view["method"], view["playing"]) == ("board", "rbf", False)
    page.tab.wait_for_timeout(700)
    address = page.tab.url
    page.tab.goto("about:blank")
    page.tab.goto(address)
    page.until("document.documentElement.dataset.ready === 'true'")
    assert page.state("adverb.view") == view


def test_the_motion_in_view_is_downloaded_and_its_requests_run(browser, service, tmp_path):
    """Files hold the motion of the goal in view; what is copied runs as it is."""
    with opened(browser, service, permissions=["clipboard-read", "clipboard-write"], accept_downloads=True) as page:
        page.open(verb="reach", **{"at.x": -0.25, "at.y": 1.3, "at.z": 0.35})
        goal = page.state("adverb.view.goal")
        assert goal == {"x": -0.25, "y": 1.3, "z": 0.35}
        body = {"adverbs": goal, "fps": 30}
        expected = httpx.post(f"{service.url}/v1/verbs/reach/sequence", json=body).json()
        group = page.tab.get_by_role("group", name="Download this motion")
        for form in ("bvh", "glb", "vrma", "npz"):
            with page.tab.expect_download() as download:
                group.get_by_role("button", name=form, exact=True).click()
            assert download.value.suggested_filename == f"reach.{form}"
            download.value.save_as(tmp_path / f"reach.{form}")
            if form != "vrma":
                motion = motion_files.read(tmp_path / f"reach.{form}").motion
                np.testing.assert_allclose(motion.root, expected["root"], atol=2e-6)
        assert b"VRMC_vrm_animation" in (tmp_path / "reach.vrma").read_bytes()
        copied = {}
        for language in ("curl", "Python", "JavaScript"):
            page.tab.get_by_role("group", name="Copy as").get_by_role("button", name=language).click()
            shown = page.tab.get_by_label(f"Request as {language}")
            shown.wait_for()
            copied[language] = shown.text_content()
            assert page.tab.evaluate("navigator.clipboard.readText()") == copied[language]
    frames = len(expected["times"])
    if shutil.which("curl"):
        subprocess.run(["sh", "-c", copied["curl"]], cwd=tmp_path, check=True)
        assert len(motion_files.read(tmp_path / "reach.glb").motion) == frames
    script = [sys.executable, "-c", copied["Python"]]
    environment = {**os.environ, "PYTHONPATH": str(PROJECT / "clients" / "python")}
    run = subprocess.run(script, capture_output=True, text=True, check=True, env=environment)
    assert run.stdout.startswith(f"({frames}, 28, 4)")
    node = ["node", "--input-type=module", "-e", copied["JavaScript"]]
    if shutil.which("node"):
        run = subprocess.run(node, capture_output=True, text=True, check=True)
        assert run.stdout.split()[0] == str(frames)


def test_keyboard_shortcuts(page):
    page.open(verb="arm3")
    page.tab.keyboard.press("Space")
    assert page.state("adverb.view.playing") is False
    verbs = page.tab.get_by_role("combobox", name="Verb").locator("option").all_inner_texts()
    page.tab.keyboard.press(str(1 + verbs.index("board")))
    page.until("adverb.shown.main?.verb === 'board'")
    page.tab.keyboard.press("?")
    page.tab.get_by_role("dialog", name="Keyboard shortcuts").wait_for()


@pytest.fixture
def driven(page):
    """The page as it opens without a link: drive mode."""
    page.tab.goto(page.service.url)
    page.until("document.documentElement.dataset.ready === 'true'")
    page.until("adverb.view.drive && adverb.shown.main?.verb === 'locomotion'")
    return page


def test_keys_drive_the_character(driven):
    x, _, z = driven.state("adverb.shown.main.root")
    driven.tab.keyboard.down("KeyW")
    driven.until(f"Math.hypot(adverb.shown.main.root[0] - {x}, adverb.shown.main.root[2] - {z}) > 0.5")
    driven.tab.keyboard.up("KeyW")
    driven.until("adverb.view.goal.forward_speed === 0")
    driven.until("adverb.drawn.contacts > 0 && adverb.drawn.slide !== null")
    driven.tab.get_by_role("region", name="Drive").get_by_text("mm").wait_for()


def test_an_action_interrupts_the_walk_where_the_character_is(driven):
    driven.tab.keyboard.down("KeyW")
    driven.until("adverb.shown.main.root[2] > 1")
    driven.tab.keyboard.up("KeyW")
    driven.tab.keyboard.press("Space")
    driven.until("adverb.shown.main.verb === 'jump'")
    assert driven.state("adverb.shown.main.root[2]") > 1
    driven.until("adverb.shown.main.verb === 'locomotion'")
    assert driven.state("adverb.shown.main.root[2]") > 1
    driven.tab.get_by_role("button", name="Stop driving").click()
    driven.until("!adverb.view.drive && adverb.drawn.goal !== null")


def test_a_stick_drives_on_a_phone(browser, service):
    with opened(browser, service, has_touch=True) as page:
        page.tab.set_viewport_size({"width": 390, "height": 844})
        page.open(drive="yes", verb="locomotion")
        assert page.tab.evaluate("document.documentElement.scrollWidth") <= 390
        box = page.tab.get_by_role("img", name="Stick").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.tab.mouse.move(x, y)
        page.tab.mouse.down()
        page.tab.mouse.move(x, y - 30)
        page.until("adverb.shown.main.root[2] > 0.3")
        page.tab.mouse.up()
        page.until("adverb.view.goal.forward_speed === 0")


def grave_violations(page):
    """Rules that the page breaks by axe, which was loaded before, with the elements."""
    found = page.tab.evaluate("axe.run().then(({violations}) => violations)")
    return [
        (one["id"], [node["target"] for node in one["nodes"]][:3])
        for one in found
        if one["impact"] in ("serious", "critical")
    ]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_serious_accessibility_violations(browser, service, scheme):
    axe = PROJECT / "clients" / "dashboard" / "node_modules" / "axe-core" / "axe.min.js"
    if not axe.is_file():
        pytest.skip("axe-core is not installed; run `make dashboard`")
    with opened(browser, service, color_scheme=scheme) as page:
        page.open(verb="reach", playing="no")
        page.tab.evaluate(axe.read_text())
        for tab in TABS:
            page.tab.get_by_role("tab", name=tab).click()
            page.tab.wait_for_timeout(500)
            assert grave_violations(page) == [], tab
        page.open(verb="locomotion", drive="yes")
        page.until("adverb.shown.main?.verb === 'locomotion'")
        assert grave_violations(page) == [], "drive"


def test_a_phone_has_no_horizontal_scrolling(browser, service):
    with opened(browser, service) as page:
        page.tab.set_viewport_size({"width": 390, "height": 844})
        page.open(verb="reach")
        assert page.tab.evaluate("document.documentElement.scrollWidth") <= 390
        for tab in TABS:
            page.tab.get_by_role("tab", name=tab).click()
            assert page.tab.evaluate("document.documentElement.scrollWidth") <= 390
