"""Blender add-on of Adverb: armatures of verbs, live poses, keyframes, and examples for verb sources."""


def register() -> None:
    """Add the panel and its operators."""
    from . import ui  # it imports bpy, which exists in Blender only

    ui.register()


def unregister() -> None:
    """Remove them."""
    from . import ui

    ui.unregister()
