"""Check the Blender add-on and Blender's reading of our files against a live server.

Run it with the Python of an environment that has Blender: ``pip install bpy==5.0.1``, then
``PYTHONPATH=clients/blender python tools/check_blender.py --server http://127.0.0.1:8000 --adverb .venv/bin/adverb``.
It prints what clients/blender/README.md records.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import bpy
from adverb_blender import armature, coordinates, ui
from adverb_blender.example import Clip, positions
from adverb_blender.rest import Server

FPS = 30
PATIENCE_S = 30.0
TIMES = 20
GOAL = {"x": -0.3, "y": 1.2, "z": 0.4}
APEX = 0.4827586206896552

Json = dict[str, Any]


def distance_mm(found: Any, expected: Any) -> float:
    """Largest distance of two lists of points, millimetres."""
    return max(1000.0 * math.dist(a, b) for a, b in zip(found, expected, strict=True))


def start(server: str) -> Any:
    """A scene with the armature of the verb `reach`, made by the operators."""
    import addon_utils  # type: ignore[import-not-found]  # it is found once bpy is imported

    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon_utils.enable("adverb_blender", default_set=True)
    scene = bpy.context.scene
    scene.render.fps = FPS
    settings = scene.adverb
    settings.server = server
    bpy.ops.adverb.connect()
    settings.verb = "reach"
    bpy.ops.adverb.create()
    return settings


def check_live(settings: Any) -> float:
    """Drag the goal to three points; distance of the hand from the last one, millimetres."""
    ui.start_live()
    settings.phase = APEX
    try:
        for x in (-0.1, -0.2, GOAL["x"]):
            settings.goal.location = coordinates.to_blender((x, GOAL["y"], GOAL["z"]))
            end = time.monotonic() + PATIENCE_S
            while True:
                bpy.context.view_layer.update()
                ui.step()
                bpy.context.view_layer.update()
                (hand,) = armature.points(settings.target, ["RightHand"])
                error_mm = distance_mm([hand], [(x, GOAL["y"], GOAL["z"])])
                if error_mm < 1.0 or time.monotonic() > end:
                    break
                time.sleep(ui.INTERVAL_S)  # as Blender's timer does
    finally:
        ui.stop_live()
    return error_mm


def check_bake(settings: Any) -> float:
    """Largest distance of joints of the baked keys from the server's positions, millimetres."""
    scene = bpy.context.scene
    scene.frame_set(1)
    scene.timeline_markers.clear()
    bpy.ops.adverb.bake()
    names = json.loads(settings.description)["skeleton"]["names"]
    sequence = Server(settings.server).sequence("reach", GOAL, FPS, space="global")
    worst = 0.0
    for k, expected in enumerate(sequence["positions"]):
        scene.frame_set(1 + k)
        worst = max(worst, distance_mm(armature.points(settings.target, names), expected))
    return worst


def check_export(settings: Any, adverb: str, folder: Path) -> Json:
    """Bake and export the verb's examples, build the verb, and compare its poses with the server's."""
    server = Server(settings.server)
    verb = server.verb("reach")
    rows = verb["examples"]
    (folder / "verb.toml").write_text(_toml(verb))
    settings.folder, settings.measured, settings.marker = str(folder), "RightHand", 1
    settings.plant = False  # the built verb has the examples as they are
    for k, row in enumerate(rows):
        settings.goal.location = coordinates.to_blender([row["adverbs"][name] for name in "xyz"])
        bpy.context.view_layer.update()
        settings.target.animation_data_clear()
        check_keys(settings)
        settings.example = f"example_{k:02d}"
        bpy.ops.adverb.export()
    artifact = folder / "reach.verb"
    built = _run(adverb, "build", str(folder), "-o", str(artifact))
    options = ("--at", _at(GOAL), "--phase", repr(APEX), "--no-plant", "--json")
    posed, ours = (
        json.loads(_run(adverb, "pose", str(artifact), *options)),
        server.pose("reach", GOAL, APEX, plant=False),
    )
    hand = [posed["measured"][name] for name in "xyz"]
    return {
        "examples": len(rows),
        "warnings": built.count("warning"),
        "hand_mm": distance_mm([hand], [list(GOAL.values())]),
        "joints_mm": distance_mm(_points(verb, posed), _points(verb, ours)),
        "exported_mm": max(_exported_mm(settings, folder, k, row) for k, row in enumerate(rows[:3])),
    }


def _points(verb: Json, pose: Json) -> list[coordinates.Vector]:
    """Joint positions of a pose."""
    skeleton = verb["skeleton"]
    clip = Clip(skeleton["names"], skeleton["parents"], skeleton["offsets"], FPS, [pose["root"]], [pose["rotations"]])
    return positions(clip, 0)


def check_keys(settings: Any) -> None:
    """Bake the motion at the goal from frame 1 on, with markers at its keytimes."""
    bpy.context.scene.frame_set(1)
    bpy.context.scene.timeline_markers.clear()
    bpy.ops.adverb.bake()


def _exported_mm(settings: Any, folder: Path, k: int, row: Json) -> float:
    """Blender reads an exported file; largest distance from the server's positions, millimetres."""
    sequence = Server(settings.server).sequence("reach", row["adverbs"], FPS, space="global", plant=False)
    return read_mm(folder / f"example_{k:02d}.bvh", sequence, _names(settings))


def _names(settings: Any) -> list[str]:
    names: list[str] = json.loads(settings.description)["skeleton"]["names"]
    return names


def _toml(verb: Json) -> str:
    adverbs = "".join(f'\n[[adverb]]\nname = "{name}"\nunit = "m"\n' for name in "xyz")
    names, chart = json.dumps(verb["keytime_names"]), json.dumps(verb["domain"]["chart"])
    head = 'name = "reach"\neffector = "RightHand"\neffector_keytime_index = 1\nmeasure = "joint_position"\n'
    return f'{head}keytime_names = {names}\nchart = {chart}\n\n[units]\nlength = "m"\n{adverbs}'


def _at(adverbs: Json) -> str:
    return ",".join(f"{name}={value}" for name, value in adverbs.items())


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: {done.stdout}{done.stderr}")
    return done.stdout if "--json" in command else done.stdout + done.stderr


def read_mm(path: Path, sequence: Json, names: list[str]) -> float:
    """Blender reads a file; largest distance of joints at 20 of its frames from the sequence, millimetres."""
    before = set(bpy.data.objects)
    if path.suffix == ".bvh":
        bpy.ops.import_anim.bvh(filepath=str(path), axis_forward="-Z", axis_up="Y", rotate_mode="NATIVE")
        first = 1
    else:
        bpy.ops.import_scene.gltf(filepath=str(path), bone_heuristic="BLENDER")
        first = 0
    (found,) = [each for each in set(bpy.data.objects) - before if each.type == "ARMATURE"]
    worst, count = 0.0, len(sequence["positions"])
    for k in range(TIMES):
        frame = round(k * (count - 2) / (TIMES - 1))
        bpy.context.scene.frame_set(first + frame)
        heads = [coordinates.from_blender(found.matrix_world @ found.pose.bones[name].head) for name in names]
        worst = max(worst, distance_mm(heads, sequence["positions"][frame]))
    return worst


def check_scene(settings: Any, folder: Path) -> None:
    """Markers, the frame, targets, the key and the live poses, each as the add-on's README has it."""
    scene = bpy.context.scene
    check_keys(settings)
    markers = sorted((marker.name, marker.frame) for marker in scene.timeline_markers)
    scene.frame_set(1)
    bpy.ops.adverb.bake()
    again = sorted((marker.name, marker.frame) for marker in scene.timeline_markers)
    _expect(again == markers, f"baked twice: {again}, once: {markers}")
    (folder / "verb.toml").touch()
    settings.folder, settings.example = str(folder), "scene"
    scene.frame_set(7)
    bpy.ops.adverb.export()
    _expect(scene.frame_current == 7, f"the frame after an export is {scene.frame_current}")
    key, file = "adv_0123456789abcdef_" + "K" * 43, folder / "scene.blend"
    bpy.context.preferences.addons["adverb_blender"].preferences.key = key
    bpy.ops.wm.save_as_mainfile(filepath=str(file), compress=False)
    bpy.context.preferences.addons["adverb_blender"].preferences.key = ""
    _expect(key.encode() not in file.read_bytes(), "the file of the scene has the key")
    target, settings.target = settings.target, bpy.data.objects.new("Mesh", bpy.data.meshes.new("Mesh"))
    ui.start_live()
    _expect(ui.step() is not None and "armature" in ui._problem, f"a mesh as target: {ui._problem!r}")
    settings.target = target
    ui.step()
    _expect(not ui._problem, f"after a mesh as target: {ui._problem!r}")
    bpy.ops.wm.open_mainfile(filepath=str(file))
    _expect(ui._live is None, "the live poses do not end where another file is opened")


def _expect(holds: bool, detail: str) -> None:
    if not holds:
        raise SystemExit(detail)


def check_files(settings: Any, folder: Path) -> dict[str, float]:
    """One motion as .bvh and .glb of the server, read by Blender: largest distances, millimetres."""
    server, found = Server(settings.server), {}
    sequence = server.sequence("reach", GOAL, FPS, space="global")
    for suffix, media_type in ((".bvh", "text/x-bvh"), (".glb", "model/gltf-binary")):
        path = folder / f"motion{suffix}"
        path.write_bytes(server.motion_file("reach", GOAL, FPS, media_type))
        found[suffix] = read_mm(path, sequence, _names(settings))
    return found


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--server", default="http://127.0.0.1:8000")
    parser.add_argument("--adverb", default=os.fspath(Path(sys.executable).with_name("adverb")))
    options = parser.parse_args()
    settings = start(options.server)
    print(f"| Blender {bpy.app.version_string}, verb reach | mm |")
    print("| --- | ---: |")
    print(f"| the hand while the goal is dragged | {check_live(settings):.4f} |")
    print(f"| joints of baked keys | {check_bake(settings):.4f} |")
    with tempfile.TemporaryDirectory() as name:
        for suffix, error_mm in check_files(settings, Path(name)).items():
            print(f"| joints of our {suffix}, read by Blender, at {TIMES} times | {error_mm:.4f} |")
        folder = Path(name) / "source"
        folder.mkdir()
        found = check_export(settings, options.adverb, folder)
        (Path(name) / "scene").mkdir()
        check_scene(settings, Path(name) / "scene")
    print(f"| joints of exported examples, read by Blender, at {TIMES} times | {found['exported_mm']:.4f} |")
    print(f"| the hand of the verb built of {found['examples']} exported examples | {found['hand_mm']:.4f} |")
    print(f"| all joints of that verb's pose there | {found['joints_mm']:.4f} |")
    print(f"warnings of adverb build: {found['warnings']}")
    print("markers, frame, targets, key and live poses of a scene: as they should be")


if __name__ == "__main__":
    main()
