"""Drafts on the dashboard: from dropped clips to a published verb, in a real browser against a real server."""

import re
import shutil
from pathlib import Path

import httpx
import pytest

from tests.dashboard.conftest import PATIENCE_S, PROJECT, opened
from tests.verbs import raw_folder
from verbs.io import bvh

pytestmark = [pytest.mark.xdist_group("dashboard"), pytest.mark.slow]

BUILT = "(window.adverbDraft && adverbDraft.blend === adverbDraft.draft.revision && !adverbDraft.saving)"


@pytest.fixture(scope="module")
def reaches(tmp_path_factory):
    return raw_folder.write(tmp_path_factory.mktemp("clips") / "reaches", raw_folder.reaches())


@pytest.fixture(scope="module")
def made(service, reaches, tmp_path_factory):
    """Makes drafts of the reaches by the API; returns their identifiers."""
    packed = Path(shutil.make_archive(str(tmp_path_factory.mktemp("zip") / "reaches"), "zip", reaches)).read_bytes()

    def make(name="hands"):
        headers = {"Content-Type": "application/zip"}
        url = f"{service.url}/v1/drafts?name={name}"
        response = httpx.post(url, content=packed, headers=headers, timeout=PATIENCE_S)
        assert response.status_code == 201, response.text
        return response.json()["id"]

    return make


def open_draft(page, draft, **view):
    page.open(draft=draft, **view)
    page.until(BUILT)
    return page


def clip(page, name):
    return page.state(f"adverbDraft.draft.clips.find((clip) => clip.name === '{name}')")


def row(page, name):
    return page.tab.get_by_role("listitem").filter(has=page.tab.get_by_role("button", name=name, exact=True))


def stored(page, draft):
    return httpx.get(f"{page.service.url}/v1/drafts/{draft}", timeout=PATIENCE_S).json()


def handle(page, name, keytime="apex"):
    return page.tab.get_by_role("slider", name=f"{keytime} of {name}", exact=True)


def drop(page, folder):
    """Choose all clips of a folder as files, which is the same as dropping them."""
    page.tab.get_by_role("tab", name="Upload").click()
    page.tab.locator("input[type=file]").first.set_input_files(sorted(folder.glob("*.*")))


def test_dropped_clips_become_a_draft_that_a_reload_keeps(page, reaches):
    page.open(verb="reach")
    drop(page, reaches)
    page.until(BUILT)
    before = page.state("adverbDraft.draft")
    assert [one["name"] for one in before["clips"]] == sorted(path.stem for path in reaches.iterdir())
    assert (before["name"], before["effector"]) == ("reach", "RightHand")
    page.tab.reload()
    page.until(BUILT)
    after = page.state("adverbDraft.draft")
    assert (after["id"], after["revision"], after["clips"]) == (before["id"], before["revision"], before["clips"])
    page.tab.get_by_role("button", name="Close").click()
    page.until("!adverb.view.draft && adverb.shown.main?.verb === 'reach'")


def test_a_draft_opened_from_drive_mode_has_playback_and_keys(page, made):
    page.open(verb="locomotion", drive="yes")
    page.until("document.documentElement.dataset.drive === 'yes'")
    page.tab.evaluate(f"location.hash += '&draft={made()}'")
    page.until(BUILT)
    page.tab.get_by_role("slider", name="Phase", exact=True).wait_for()
    page.tab.keyboard.press("Space")
    page.tab.get_by_role("button", name="Pause (space)").wait_for()
    page.tab.keyboard.press("w")
    assert page.state("adverb.view.goal.forward") in (None, 0)
    page.tab.get_by_role("button", name="Close").click()
    page.until("document.documentElement.dataset.drive === 'yes'")


def test_a_dragged_keytime_is_saved_and_changes_the_blend(page, made):
    draft = made()
    open_draft(page, draft)
    name = "reach_4"
    adverbs, before = clip(page, name)["adverbs"], clip(page, name)["keytimes"]
    revision = page.state("adverbDraft.draft.revision")
    grip = handle(page, name)
    grip.scroll_into_view_if_needed()
    box = grip.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.tab.mouse.move(x, y)
    page.tab.mouse.down()
    page.tab.mouse.move(x + 40, y, steps=8)
    during = clip(page, name)
    assert during["keytimes"][1] > before[1] + 0.1
    page.tab.mouse.up()
    page.until(f"adverbDraft.draft.revision > {revision} && ({BUILT})")
    saved = next(one for one in stored(page, draft)["clips"] if one["name"] == name)
    assert saved["keytimes"] == clip(page, name)["keytimes"]
    assert saved["keytimes"][1] == pytest.approx(during["keytimes"][1], abs=0.02)
    assert saved["set"]
    assert saved["adverbs"] != adverbs


def test_arrow_keys_move_a_keytime_by_frames(page, made):
    draft = made()
    open_draft(page, draft, clip="reach_2")
    before, drawn = clip(page, "reach_2")["keytimes"], page.state("adverbDraft.drawn.effector")
    handle(page, "reach_2").focus()
    page.tab.keyboard.press("Shift+ArrowLeft")
    page.tab.keyboard.press("ArrowRight")
    page.until(f"adverbDraft.draft.revision > 1 && ({BUILT})")
    moved = next(one for one in stored(page, draft)["clips"] if one["name"] == "reach_2")["keytimes"]
    assert moved[1] == pytest.approx(before[1] - 9 / raw_folder.FPS, abs=1e-3)
    assert [moved[0], moved[2]] == [before[0], before[2]]
    page.until(f"Math.hypot(...adverbDraft.drawn.effector.map((value, k) => value - {drawn}[k])) > 1e-4")
    page.tab.get_by_role("button", name="As proposed").click()
    page.until(f"adverbDraft.draft.revision > 2 && ({BUILT})")


def test_touch_moves_a_keytime(browser, service, made):
    with opened(browser, service, has_touch=True) as page:
        page.tab.set_viewport_size({"width": 390, "height": 844})
        open_draft(page, made(), clip="reach_1")
        assert page.tab.evaluate("document.documentElement.scrollWidth") <= 390
        before = clip(page, "reach_1")["keytimes"][1]
        grip = handle(page, "reach_1")
        grip.scroll_into_view_if_needed()
        box = grip.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        touch = page.tab.context.new_cdp_session(page.tab)
        touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
        for step in (10, 20, 30):
            touch.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [{"x": x + step, "y": y}]})
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        page.until(f"adverbDraft.draft.revision > 1 && ({BUILT})")
        assert clip(page, "reach_1")["keytimes"][1] > before


def test_an_awkward_folder_shows_each_fault_and_its_mend(page, tmp_path):
    page.open(verb="reach")
    drop(page, raw_folder.awkward_folder(tmp_path / "awkward"))
    page.until(BUILT)
    for name, reason in raw_folder.AWKWARD.items():
        row(page, name.removesuffix(".bvh")).get_by_text(reason).wait_for()
    assert row(page, "truncated").get_by_role("checkbox").is_disabled()
    page.tab.get_by_role("button", name="spinning", exact=True).click()
    mend = row(page, "spinning").get_by_role("checkbox", name=re.compile("^Mend"))
    assert mend.is_checked()
    motion = page.state("adverbDraft.draft.motion")
    mend.uncheck()
    page.until(f"adverbDraft.draft.motion !== '{motion}' && !adverbDraft.saving")
    mend.check()
    page.until(f"adverbDraft.draft.motion === '{motion}' && ({BUILT})")


def test_an_excluded_clip_leaves_the_verb_and_comes_back(page, made):
    open_draft(page, made())
    page.tab.get_by_role("checkbox", name="Use reach_3").uncheck()
    page.until(f"adverbDraft.draft.verb.examples.length === 8 && ({BUILT})")
    page.tab.get_by_text("9 clips, 8 used").wait_for()
    page.tab.get_by_role("checkbox", name="Use reach_3").check()
    page.until(f"adverbDraft.draft.verb.examples.length === 9 && ({BUILT})")


def test_too_few_clips_make_no_verb_and_can_be_put_right(page, made):
    open_draft(page, made())
    for k in range(9):
        page.tab.get_by_role("checkbox", name=f"Use reach_{k}").uncheck()
    page.until("adverbDraft.draft.verb === null && !adverbDraft.saving")
    page.tab.get_by_role("alert").get_by_text("No verb yet").wait_for()
    assert page.tab.get_by_role("button", name="Publish…").is_disabled()
    for k in range(9):
        page.tab.get_by_role("checkbox", name=f"Use reach_{k}").check()
    page.until(f"adverbDraft.draft.verb?.examples.length === 9 && ({BUILT})")


def test_another_clients_change_is_loaded_with_a_message(page, made):
    draft = made()
    open_draft(page, draft)
    url = f"{page.service.url}/v1/drafts/{draft}"
    assert httpx.patch(url, json={"description": "theirs"}, timeout=PATIENCE_S).status_code == 200
    page.tab.get_by_role("checkbox", name="Use reach_3").uncheck()
    page.tab.get_by_role("alert").get_by_text("Another client changed this draft").wait_for()
    assert page.state("adverbDraft.draft.description") == "theirs"
    assert page.tab.get_by_role("checkbox", name="Use reach_3").is_checked()
    page.ignore("412")


def test_a_goal_of_the_blend_is_set_with_a_slider_and_by_dragging(page, made):
    draft = made()
    page.tab.set_viewport_size({"width": 1280, "height": 720})
    open_draft(page, draft)
    before = page.state("adverbDraft.goal.x")
    page.tab.get_by_role("slider", name="x, m").focus()
    for _ in range(5):
        page.tab.keyboard.press("ArrowRight")
    after = page.state("adverbDraft.goal.x")
    assert after > before
    page.until("adverbDraft.drawn.handle !== null")
    page.until(f"Math.abs(adverbDraft.drawn.goal[0] - {after}) < 1e-3")
    x, y = page.state("adverbDraft.drawn.handle")
    page.tab.mouse.move(x, y)
    page.tab.mouse.down()
    page.tab.mouse.move(x + 20, y - 10, steps=4)
    page.tab.mouse.up()
    goal = page.state("adverbDraft.goal")
    assert goal["x"] != after
    request = {"adverbs": goal, "phase": page.state("adverbDraft.phase"), "space": "global"}
    pose = httpx.post(f"{page.service.url}/v1/drafts/{draft}/pose", json=request, timeout=PATIENCE_S).json()
    hand = pose["positions"][page.state("adverbDraft.draft.verb.skeleton.names").index("RightHand")]
    page.until(f"Math.hypot(...adverbDraft.drawn.effector.map((value, k) => value - {hand}[k])) < 0.003")


def test_a_renamed_draft_is_published_and_then_a_new_version(page, made):
    draft = made()
    open_draft(page, draft)
    page.tab.get_by_label("Name of adverb 1").fill("leftward")
    page.tab.get_by_label("Name of adverb 1").press("Tab")
    page.tab.get_by_label("Name of keytime 2").fill("touch")
    page.tab.get_by_label("Name of keytime 2").press("Tab")
    page.until("adverbDraft.draft.verb?.adverbs[0].name === 'leftward' && !adverbDraft.saving")
    page.tab.get_by_role("button", name="Publish…").click()
    page.tab.get_by_label("Name of the verb").fill("touching")
    page.tab.get_by_role("dialog").get_by_role("button", name="Publish").click()
    page.until("adverb.view.verb === 'touching' && adverb.shown.main?.version === 1")
    verb = httpx.get(f"{page.service.url}/v1/verbs/touching").json()
    assert verb["adverbs"][0]["name"] == "leftward"
    assert verb["keytime_names"][1] == "touch"
    open_draft(page, draft)
    page.tab.get_by_role("checkbox", name="Use reach_3").uncheck()
    page.tab.get_by_role("button", name="Publish…").click()
    page.tab.get_by_label("Name of the verb").fill("touching")
    page.tab.get_by_text("touching exists as version 1").wait_for()
    page.tab.get_by_role("button", name="Publish new version").click()
    page.until("adverb.shown.main?.verb === 'touching' && adverb.shown.main.version === 2")
    page.until("adverb.view.goal.leftward !== undefined")


def test_a_clip_is_added_to_a_published_verb(page, made, tmp_path):
    draft = made("growing")
    published = httpx.post(f"{page.service.url}/v1/drafts/{draft}/publish", json={}, timeout=PATIENCE_S)
    assert published.status_code == 201, published.text
    extra = tmp_path / "reach_extra.bvh"
    bvh.write(raw_folder.reach(0.3, 0.3, frames=95), extra, decimals=7)
    page.open(verb="growing")
    page.tab.locator(".add-clip input").set_input_files(extra)
    page.tab.get_by_text("published growing v2").wait_for()
    page.until("adverb.shown.main?.version === 2")
    assert len(httpx.get(f"{page.service.url}/v1/verbs/growing").json()["examples"]) == 10


def test_a_draft_is_listed_and_deleted(page, made):
    draft = made("passing")
    page.open(verb="reach", panel="upload")
    page.tab.get_by_role("list", name="Drafts").get_by_role("link", name="passing").click()
    page.until(BUILT)
    page.tab.get_by_role("button", name="Delete draft…").click()
    page.tab.get_by_role("dialog").get_by_role("button", name="Delete draft").click()
    page.until("!adverb.view.draft")
    assert httpx.get(f"{page.service.url}/v1/drafts/{draft}").status_code == 404
    page.tab.goto(f"{page.service.url}/#draft={draft}")
    page.tab.get_by_text("This draft does not exist").wait_for()
    page.ignore("404")


def test_files_without_clips_are_refused_on_the_page(page, tmp_path):
    (tmp_path / "notes.csv").write_text("nothing moves here")
    page.open(verb="reach")
    drop(page, tmp_path)
    page.tab.get_by_text("No clips found").wait_for()


def test_captured_punches_are_published(page, mocap, tmp_path):
    for path in (mocap / "punch").glob("*.bvh"):
        shutil.copy(path, tmp_path)
    page.open(verb="reach")
    drop(page, tmp_path)
    page.until(BUILT)
    assert page.state("adverbDraft.draft.verb.examples.length") == 21
    page.tab.get_by_role("button", name="Publish…").click()
    page.tab.get_by_role("dialog").get_by_role("button", name="Publish").click()
    page.until("adverb.view.verb === 'punch' && adverb.shown.main?.verb === 'punch'")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_draft_has_no_serious_accessibility_violations(browser, service, made, scheme):
    axe = PROJECT / "clients" / "dashboard" / "node_modules" / "axe-core" / "axe.min.js"
    if not axe.is_file():
        pytest.skip("axe-core is not installed; run `make dashboard`")
    with opened(browser, service, color_scheme=scheme) as page:
        open_draft(page, made(), clip="reach_2")
        page.tab.evaluate(axe.read_text())
        found = page.tab.evaluate("axe.run().then(({violations}) => violations)")
        grave = [
            (one["id"], [node["target"] for node in one["nodes"]][:3])
            for one in found
            if one["impact"] in ("serious", "critical")
        ]
        assert grave == []
