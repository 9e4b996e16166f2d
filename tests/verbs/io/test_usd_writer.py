"""USD files as usd-core reads them."""

import sys

import numpy as np
import pytest

from tests.verbs.io.test_gltf_writer import motion_of
from verbs.errors import RequestError
from verbs.io import motion_files
from verbs.kernels import fk


@pytest.fixture
def pxr():
    return pytest.importorskip("pxr", reason="usd-core is not installed: pip install 'adverb[usd]'")


@pytest.mark.parametrize("ending", ["usd", "usda"])
def test_usd_core_poses_a_motion_as_we_do(pxr, ending, tmp_path):
    from pxr import Usd, UsdGeom, UsdSkel

    motion = motion_of("reach")
    extras = {"verb": "reach", "version": 2, "adverbs": {"x": 0.5}}
    motion_files.write(motion, tmp_path / f"a.{ending}", name="reach", extras=extras)
    stage = Usd.Stage.Open(str(tmp_path / f"a.{ending}"))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1.0)
    assert (stage.GetTimeCodesPerSecond(), stage.GetEndTimeCode()) == (30.0, len(motion) - 1)
    assert stage.GetRootLayer().customLayerData == extras
    prim = stage.GetPrimAtPath("/reach/Skeleton")
    query = UsdSkel.Cache().GetSkelQuery(UsdSkel.Skeleton(prim))
    assert query
    places = fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]
    for frame in np.linspace(0, len(motion) - 1, 20).astype(int):
        found = np.array(query.ComputeJointSkelTransforms(int(frame)))[:, 3, :3]
        np.testing.assert_allclose(found, places[frame], atol=1e-4)


def test_usd_core_finds_no_fault(pxr, tmp_path):
    from pxr import Usd, UsdValidation

    motion_files.write(motion_of("walk"), tmp_path / "a.usda", name="1 walk")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetMessage() for error in errors] == []


def test_without_usd_core_the_package_to_install_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(RequestError, match=r"pip install 'adverb\[usd\]'"):
        motion_files.dump(motion_of("arm3"), "usd")
