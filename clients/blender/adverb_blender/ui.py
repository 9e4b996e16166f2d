"""Panel "Adverb" in the sidebar of the 3D view, and its operators."""

import json
from pathlib import Path

import bpy

from . import armature, coordinates, example
from .live import Goal, LivePoses
from .rest import Server, ServerError

INTERVAL_S = 1 / 30
_live: LivePoses | None = None
_problem = ""  # what is wrong with the scene or the poses, while Live is on


class AdverbValue(bpy.types.PropertyGroup):
    value: bpy.props.FloatProperty(name="Value")
    low: bpy.props.FloatProperty()
    high: bpy.props.FloatProperty()


class AdverbPreferences(bpy.types.AddonPreferences):
    """The key is kept with the preferences of the user: files of scenes are given to others."""

    bl_idname = __package__
    key: bpy.props.StringProperty(name="Key", subtype="PASSWORD")

    def draw(self, _context):
        self.layout.prop(self, "key")


class AdverbSettings(bpy.types.PropertyGroup):
    server: bpy.props.StringProperty(name="Server", default="http://127.0.0.1:8000")
    verbs: bpy.props.StringProperty()
    verb: bpy.props.EnumProperty(name="Verb", items=lambda self, _: _verb_items(self))
    description: bpy.props.StringProperty()
    target: bpy.props.PointerProperty(
        name="Armature", type=bpy.types.Object, poll=lambda _, found: found.type == "ARMATURE"
    )
    goal: bpy.props.PointerProperty(name="Goal", type=bpy.types.Object)
    adverbs: bpy.props.CollectionProperty(type=AdverbValue)
    phase: bpy.props.FloatProperty(name="Phase", default=0.5, min=0.0, max=1.0)
    plant: bpy.props.BoolProperty(name="Hold feet", default=True, description="Standing feet stay where they landed")
    folder: bpy.props.StringProperty(name="Source folder", subtype="DIR_PATH")
    example: bpy.props.StringProperty(name="Example", default="example")
    measured: bpy.props.StringProperty(
        name="Measured bone", description="Its position gives x, y, z; empty: the values"
    )
    marker: bpy.props.IntProperty(name="At keytime", default=1, min=0, description="Keytime of the measured bone")


_items = []  # Blender needs the texts of an enumeration to be kept


def _verb_items(settings):
    _items[:] = [(name, name, "") for name in json.loads(settings.verbs or "[]")] or [("none", "–", "Connect first")]
    return _items


def _settings(context=None):
    return (context or bpy.context).scene.adverb


def _preferences():
    return bpy.context.preferences.addons[__package__].preferences


def _server():
    return Server(_settings().server, _preferences().key)


def _target(settings):
    """The armature.

    Raises
    ------
    ValueError
        If there is none.
    """
    if settings.target is None or settings.target.type != "ARMATURE":
        raise ValueError("create or choose an armature first")
    return settings.target


def adverbs_of(settings):
    """Adverbs by name: of the goal, in the space of the armature, where the verb has x, y, z; else the values."""
    names = [row.name for row in settings.adverbs]
    if settings.goal is not None and names == ["x", "y", "z"]:
        point = _target(settings).matrix_world.inverted() @ settings.goal.matrix_world.translation
        return dict(zip(names, coordinates.from_blender(point), strict=True))
    return {row.name: row.value for row in settings.adverbs}


class _Call(bpy.types.Operator):
    """An operator whose failed calls are reported."""

    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        try:
            return self.run(context, _settings(context))
        except (ServerError, ValueError, OSError) as err:
            self.report({"ERROR"}, str(err))
        except (AttributeError, KeyError, TypeError) as err:  # an answer, or an armature, of another kind
            self.report({"ERROR"}, f"{type(err).__name__}: {err}")
        return {"CANCELLED"}


class ADVERB_OT_connect(_Call):
    bl_idname, bl_label = "adverb.connect", "Connect"
    bl_description = "Read the verbs of the server"

    def run(self, _context, settings):
        settings.verbs = json.dumps(_server().verbs())
        return {"FINISHED"}


class ADVERB_OT_create(_Call):
    bl_idname, bl_label = "adverb.create", "Create armature"
    bl_description = "Make an armature of the verb's skeleton, and an empty as goal where the verb has x, y, z"

    def run(self, _context, settings):
        verb = _server().verb(settings.verb)
        settings.description = json.dumps({"name": verb["name"], "skeleton": verb["skeleton"]})
        settings.target = armature.build(f"Adverb {verb['name']}", verb["skeleton"])
        settings.adverbs.clear()
        first = verb["examples"][0]["adverbs"]
        for row in verb["adverbs"]:
            item = settings.adverbs.add()
            item.name, item.low, item.high, item.value = row["name"], row["min"], row["max"], first[row["name"]]
        settings.goal = None
        if [row["name"] for row in verb["adverbs"]] == ["x", "y", "z"]:
            empty = bpy.data.objects.new("Adverb goal", None)
            empty.empty_display_size = 0.05
            empty.location = coordinates.to_blender([row.value for row in settings.adverbs])
            bpy.context.collection.objects.link(empty)
            settings.goal = empty
        return {"FINISHED"}


class ADVERB_OT_live(_Call):
    bl_idname, bl_label = "adverb.live", "Live"
    bl_description = "Follow the goal while it is dragged; again: stop"

    def run(self, _context, settings):
        if _live is None:
            _described(settings)
            start_live()
        else:
            stop_live()
        return {"FINISHED"}


def start_live() -> None:
    """Start the thread of requests and the timer that shows its poses."""
    global _live, _problem
    _live, _problem = LivePoses(_server()), ""
    bpy.app.timers.register(step)


def stop_live() -> None:
    """Stop both."""
    global _live
    if _live is not None:
        _live.stop()
        _live = None


def step() -> float | None:
    """Set the goal, and show the newest pose; called by the timer in Blender's own thread."""
    global _problem
    settings, before = _settings(), _problem
    if _live is None or settings.target is None:
        stop_live()
        return None
    shown = False
    try:
        shown = _show(settings, _live)
        _problem = str(_live.error or "")
    except (AttributeError, KeyError, TypeError, ValueError, ReferenceError) as err:  # it may be mended in the scene
        _problem = f"{type(err).__name__}: {err}"
    if shown or _problem != before:
        _redraw()
    return INTERVAL_S


def _show(settings, live):
    """Set the goal, and show the newest pose; whether there was one."""
    verb, target = _described(settings), _target(settings)
    live.aim(Goal(verb["name"], tuple(adverbs_of(settings).items()), settings.phase))
    pose = live.take()
    if pose is not None:
        armature.apply(target, verb["skeleton"]["names"], pose["root"], pose["rotations"])
    return pose is not None


def _described(settings):
    """The verb of the armature.

    Raises
    ------
    ValueError
        If there is none.
    """
    _target(settings)
    if not settings.description:
        raise ValueError("create an armature first")
    return json.loads(settings.description)


def _redraw():
    """Draw the 3D views again, with their panels."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


@bpy.app.handlers.persistent
def _on_load(*_):
    """Another file is opened, which removes the timer."""
    stop_live()


class ADVERB_OT_bake(_Call):
    bl_idname, bl_label = "adverb.bake", "Bake keyframes"
    bl_description = "Key the whole motion at the frame rate of the scene, from the current frame on"

    def run(self, context, settings):
        verb, scene = _described(settings), context.scene
        fps = scene.render.fps / scene.render.fps_base
        sequence = _server().sequence(verb["name"], adverbs_of(settings), fps, plant=settings.plant)
        start = scene.frame_current
        last = armature.bake(settings.target, verb["skeleton"]["names"], sequence, start)
        _remove_markers(scene, [marker["name"] for marker in sequence["events"]], start)
        for marker in sequence["events"]:
            scene.timeline_markers.new(marker["name"], frame=round(start + marker["time"] * fps))
        scene.frame_end = max(scene.frame_end, last)
        return {"FINISHED"}


def _remove_markers(scene, names, start):
    """Remove the keytimes of an earlier motion that was baked from the same frame."""
    found = list(scene.timeline_markers)
    for k in example.stale_markers([(marker.name, marker.frame) for marker in found], names, start):
        scene.timeline_markers.remove(found[k])


class ADVERB_OT_export(_Call):
    bl_idname, bl_label = "adverb.export", "Export example"
    bl_description = "Write the motion between the first and the last timeline marker as an example of a verb source"

    def run(self, context, settings):
        if not settings.folder:
            raise ValueError("choose a folder")
        scene = context.scene
        markers = [(marker.name, marker.frame) for marker in scene.timeline_markers]
        start = min((frame for _, frame in markers), default=scene.frame_start)
        fps = scene.render.fps / scene.render.fps_base
        keytimes = example.keytimes_of(markers, start, fps)
        clip = armature.read(_target(settings), scene, start, max(frame for _, frame in markers))
        values = self.values(settings, clip, keytimes)
        path = example.save_example(Path(bpy.path.abspath(settings.folder)), settings.example, clip, keytimes, values)
        self.report({"INFO"}, f"{path}, keytimes {keytimes}")
        return {"FINISHED"}

    def values(self, settings, clip, keytimes):
        """Values of the adverbs: the position of the measured bone at its keytime, or those of the panel."""
        if not settings.measured:
            return [row.value for row in settings.adverbs]
        if settings.measured not in clip.names or settings.marker >= len(keytimes):
            raise ValueError("the measured bone or its keytime does not exist")
        frame = round(keytimes[settings.marker] * clip.fps)
        return example.positions(clip, frame)[clip.names.index(settings.measured)]


class ADVERB_PT_panel(bpy.types.Panel):
    bl_label, bl_category = "Adverb", "Adverb"
    bl_space_type, bl_region_type = "VIEW_3D", "UI"

    def draw(self, context):
        settings, layout = _settings(context), self.layout
        layout.prop(settings, "server")
        layout.prop(_preferences(), "key")
        layout.operator("adverb.connect")
        layout.prop(settings, "verb")
        layout.operator("adverb.create")
        for name in ("target", "goal", "phase"):
            layout.prop(settings, name)
        for row in settings.adverbs:
            layout.prop(row, "value", text=f"{row.name} ({row.low:g} to {row.high:g})")
        layout.operator("adverb.live", depress=_live is not None)
        if _live is not None and _problem:
            layout.label(text=_problem, icon="ERROR")
        layout.prop(settings, "plant")
        layout.operator("adverb.bake")
        box = layout.box()
        for name in ("folder", "example", "measured", "marker"):
            box.prop(settings, name)
        box.operator("adverb.export")


CLASSES = (
    AdverbPreferences, AdverbValue, AdverbSettings, ADVERB_OT_connect, ADVERB_OT_create, ADVERB_OT_live, ADVERB_OT_bake,
    ADVERB_OT_export, ADVERB_PT_panel,
)  # fmt: skip


def register() -> None:
    """Add the panel, its operators and settings."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.adverb = bpy.props.PointerProperty(type=AdverbSettings)
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    """Remove them."""
    stop_live()
    bpy.app.handlers.load_pre.remove(_on_load)
    del bpy.types.Scene.adverb
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
