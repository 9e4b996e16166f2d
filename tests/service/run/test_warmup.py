"""What is loaded before the first fork: every kernel that serving, building and refining need, and no plotting."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numba.core.dispatcher import Dispatcher

from service.catalog.catalog import Entry
from service.refinement.worker.acceptance import compare
from tests.service.conftest import sway_source
from verbs import library, refine_quality
from verbs.authoring.fit import build
from verbs.domain import random_points
from verbs.io import artifact
from verbs.refine import Rules, refine, with_basis

LONGEST_S = 120.0


def loaded() -> dict[str, int]:
    """How many signatures of each compiled function are loaded."""
    modules = [module for name, module in sys.modules.items() if name.partition(".")[0] in ("verbs", "service")]
    kernels = {one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher)}
    return {f"{one.__module__}.{one.__name__}": len(one.overloads) for one in kernels}


def work() -> None:
    """Do what servers, sandboxes and refiners do, and print what was loaded before and after."""
    before = loaded()
    sources = [Path(library.__file__).parent / name for name in ("arm3", "board", "reach")]
    folder = Path(tempfile.mkdtemp(dir=os.environ["FOLDER"]))
    for verb in [build(path).verb for path in (*sources, sway_source(folder), *map(Path, sys.argv[1:]))]:
        artifact.save(verb, folder / f"{verb.name}.verb")
        Entry.of_verb(artifact.load(folder / f"{verb.name}.verb"), path=folder)
    verb, rules = library.load("arm3"), Rules(target_error=0.0, max_pseudo=3)
    *_, last = refine(verb, rules)
    new = with_basis(verb, last.basis, rules, last.mark)
    compare(verb, new, "hybrid", random_points(verb, np.random.default_rng(0), 10))
    Entry.of_verb(new, path=folder)
    reach, quality = library.load("reach"), refine_quality.Rules(samples=10, max_pseudo=1)
    *_, step = refine_quality.refine(reach, quality)
    refine_quality.compare(reach, refine_quality.with_basis(reach, step.basis, quality, step.mark), 1)
    sys.stdout.write(json.dumps({"before": before, "after": loaded(), "plots": "matplotlib" in sys.modules}))


def test_nothing_is_loaded_after_the_fork(warm, tmp_path):
    check(warm, tmp_path)


def test_nothing_is_loaded_for_jumps_and_walks(warm, tmp_path, mocap):
    check(warm, tmp_path, str(mocap / "jump"), str(mocap / "locomotion"))


def check(warm, folder, *sources):
    """Compare the kernels that are loaded in a fork before and after its work."""
    environment = {**os.environ, "FOLDER": str(folder)}
    process = warm.start(*sources, target=f"{__name__}:work", environment=environment, stdout=subprocess.PIPE)
    found = json.loads(process.stdout.read())
    assert process.wait(LONGEST_S) == 0
    process.end()
    assert len(found["before"]) > 20
    assert not found["plots"]
    later = {name: count for name, count in found["after"].items() if count != found["before"].get(name, 0)}
    assert later == {}
