"""BVH files as other readers understand them: the oracles are upc-pymotion and bvhio."""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path

import numpy as np
import pytest

from verbs.io import bvh
from verbs.kernels import fk
from verbs.motion import Motion

ORDERS = ["".join(axes) for axes in itertools.permutations("XYZ")]


def positions(motion: Motion) -> np.ndarray:
    return fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]


def by_pymotion(path: Path) -> np.ndarray:
    """Joint positions (F, J, 3) by upc-pymotion, which adds 1e-8 to each length that it divides by."""
    from pymotion.io.bvh import BVH
    from pymotion.ops.skeleton_np import fk_quat

    reader = BVH()
    reader.load(str(path))
    rotations, places, parents, *_ = reader.get_data()
    return fk_quat(rotations, places[:, 0], places, parents)[0]


def by_bvhio(path: Path, frames: list[int]) -> np.ndarray:
    """Joint positions (frames, J, 3) by bvhio, which computes in single precision."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it imports glm by a deprecated name
        import bvhio

        root = bvhio.readAsHierarchy(str(path))
        poses = []
        for frame in frames:
            root.loadPose(frame)
            poses.append([list(joint.PositionWorld) for joint, _, _ in root.layout()])
    return np.array(poses)


def foreign(seed: int, folder: Path) -> Path:
    """Return a file in which every joint has its own rotation order and some have position channels."""
    rng = np.random.default_rng(seed)
    count, frames = 8, 5
    parents = [-1, 0, 1, 2, 1, 0, 5, 5]
    children = [[c for c in range(count) if parents[c] == p] for p in range(count)]
    orders = [ORDERS[int(rng.integers(6))] for _ in range(count)]
    moving = [joint == 0 or rng.random() < 0.4 for joint in range(count)]
    columns: list[np.ndarray] = []

    def block(joint: int) -> str:
        turns = " ".join(f"{axis}rotation" for axis in orders[joint])
        places = "Xposition Yposition Zposition " if moving[joint] else ""
        if moving[joint]:
            columns.append(rng.normal(size=(frames, 3)) if joint == 0 else np.tile(rng.normal(size=3), (frames, 1)))
        columns.append(rng.uniform(-180, 180, (frames, 3)))
        inside = "".join(block(child) for child in children[joint]) or "End Site\n{\nOFFSET 0 1 0\n}\n"
        offset = " ".join(f"{value:.6f}" for value in rng.normal(size=3))
        head = f"{'JOINT' if joint else 'ROOT'} j{joint}\n{{\nOFFSET {offset}\n"
        return f"{head}CHANNELS {6 if moving[joint] else 3} {places}{turns}\n{inside}}}\n"

    header = block(0)
    rows = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in np.hstack(columns))
    path = folder / f"foreign{seed}.bvh"
    path.write_text(f"HIERARCHY\n{header}MOTION\nFrames: {frames}\nFrame Time: 0.04\n{rows}\n")
    return path


@pytest.mark.parametrize("seed", range(4))
def test_files_with_mixed_channels_pose_as_other_readers_pose_them(seed, tmp_path):
    path = foreign(seed, tmp_path)
    ours = positions(bvh.read(path))
    np.testing.assert_allclose(ours, by_pymotion(path), atol=1e-6)
    np.testing.assert_allclose(ours, by_bvhio(path, [*range(5)]), atol=1e-5)  # single precision


@pytest.mark.parametrize("seed", range(2))
def test_what_we_write_poses_in_other_readers_as_it_was(seed, tmp_path):
    motion = bvh.read(foreign(seed, tmp_path))
    bvh.write(motion, tmp_path / "written.bvh", order=ORDERS[seed])
    np.testing.assert_allclose(by_pymotion(tmp_path / "written.bvh"), positions(motion), atol=1e-5)
    np.testing.assert_allclose(by_bvhio(tmp_path / "written.bvh", [*range(5)]), positions(motion), atol=1e-5)


def test_real_capture_poses_as_other_readers_pose_it(mocap):
    paths = [sorted(folder.glob("*.bvh"))[0] for folder in sorted(mocap.iterdir()) if folder.is_dir()]
    assert paths
    for path in paths:
        ours = positions(bvh.read(path))
        np.testing.assert_allclose(ours, by_pymotion(path), atol=1e-6)
    np.testing.assert_allclose(ours[[0, 40, 80]], by_bvhio(path, [0, 40, 80]), atol=1e-5)  # single precision
