"""USD writer: a motion as a ``UsdSkel`` skeleton with its animation. Needs the extra ``usd``.

Metres, +Y up, a time code for each frame. The text is written by usd-core.

Source: Pixar, "UsdSkel: USD Skeleton Schema".
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.errors import RequestError
from verbs.io.mannequin import rest_positions
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["dump"]


def dump(motion: Motion, *, name: str = "motion", extras: Mapping[str, Any] | None = None) -> bytes:
    """Text of a ``.usda`` file, which may end in ``.usd`` too.

    Parameters
    ----------
    motion : Motion
    name : str
        Name of the top prim.
    extras : mapping, optional
        Text and numbers for the ``customLayerData`` of the file.

    Raises
    ------
    RequestError
        usd-core is not installed.
    """
    try:
        from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt
    except ImportError as err:
        raise RequestError("USD files need usd-core: pip install 'adverb[usd]'") from err
    skeleton = motion.skeleton
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(motion.fps)
    stage.SetFramesPerSecond(motion.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(motion) - 1)
    if extras:
        stage.GetRootLayer().customLayerData = {key: _plain(value) for key, value in extras.items()}
    top = UsdSkel.Root.Define(stage, f"/{_identifier(name)}")
    stage.SetDefaultPrim(top.GetPrim())
    own = UsdSkel.Skeleton.Define(stage, top.GetPath().AppendChild("Skeleton"))
    paths = _joint_paths(skeleton)
    places, tips = rest_positions(skeleton)
    ground = np.array([0.0, -float(np.concatenate([places, tips])[:, 1].min()), 0.0])

    def moved(places: F64) -> Any:
        return Vt.Matrix4dArray([Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*place)) for place in places.tolist()])

    local = skeleton.offsets.copy()
    local[0] = ground
    own.CreateJointsAttr(paths)
    own.CreateBindTransformsAttr(moved(places + ground))
    own.CreateRestTransformsAttr(moved(local))
    animation = UsdSkel.Animation.Define(stage, own.GetPath().AppendChild("Animation"))
    animation.CreateJointsAttr(paths)
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0)] * len(skeleton)))
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    smooth = quat.unroll(quat.normalize(motion.rotations)).astype(np.float32)
    for frame in range(len(motion)):
        local[0] = motion.root[frame]
        translations.Set(Vt.Vec3fArray([Gf.Vec3f(*place) for place in local.tolist()]), frame)
        turns = [Gf.Quatf(w, x, y, z) for x, y, z, w in smooth[frame].tolist()]
        rotations.Set(Vt.QuatfArray(turns), frame)
    binding = UsdSkel.BindingAPI.Apply(own.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    text: str = stage.GetRootLayer().ExportToString()
    return text.encode()


def _plain(value: Any) -> Any:
    """A value that layer data can hold: text, a number, or a table of these."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    return value if isinstance(value, (str, int, float)) else str(value)


def _identifier(name: str) -> str:
    """Name with the characters that USD allows; a digit does not come first."""
    text = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return text if re.match(r"[A-Za-z_]", text) else f"_{text}"


def _joint_paths(skeleton: Skeleton) -> list[str]:
    """Path of each joint from the root, with unique names of allowed characters."""
    taken: set[str] = set()
    paths: list[str] = []
    for name, parent in zip(skeleton.names, skeleton.parents.tolist(), strict=True):
        base = own = _identifier(name)
        number = 1
        while own in taken:
            number += 1
            own = f"{base}_{number}"
        taken.add(own)
        paths.append(f"{paths[parent]}/{own}" if parent >= 0 else own)
    return paths
