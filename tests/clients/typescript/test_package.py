"""The npm package in an empty project: installation, types, and the first example of its README."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import pytest

from tests.clients.typescript.node import NODE, PACKAGE, PROJECT

NPM = shutil.which("npm")
READMES = (PACKAGE / "README.md", PROJECT / "README.md")
PATIENCE_S = 240.0

pytestmark = pytest.mark.skipif(NPM is None, reason="npm is not installed")

USES = """
import { connect, Evaluator, type Pose, UnknownName } from "adverb-client";
import { applyPose } from "adverb-client/three";
const stream = await connect("http://127.0.0.1:8000", { key: "adv_1" });
const verb = await stream.client.call("get", "/v1/verbs/{verb}", { path: { verb: "reach" } });
const pose: Pose | null = (await stream.open(verb.name, { adverbs: { x: 1 } })).pose();
if (pose) applyPose({ bones: [] }, pose, { Hips: "pelvis" });
const evaluator: Evaluator = await Evaluator.load(await stream.client.verbFile("reach"));
console.log(evaluator.verb.name, UnknownName);
// @ts-expect-error no such route
stream.client.call("get", "/v1/nothing");
"""


def run(*command, cwd, **options):
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=PATIENCE_S, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    """Files of the package, and its archive."""
    folder = tmp_path_factory.mktemp("packed")
    text = run(NPM, "pack", "--json", "--ignore-scripts", "--pack-destination", str(folder), cwd=PACKAGE)
    (report,) = json.loads(text)
    return {row["path"] for row in report["files"]}, folder / report["filename"]


@pytest.fixture(scope="module")
def project(packed, tmp_path_factory):
    """An empty project with the package."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "package.json").write_text('{"name": "empty", "private": true, "type": "module"}')
    run(NPM, "install", "--offline", "--no-audit", "--no-fund", "--ignore-scripts", str(packed[1]), cwd=folder)
    return folder


def test_it_has_what_users_need_and_nothing_else(packed):
    files, _ = packed
    assert {"package.json", "README.md", "LICENSE", "dist/index.js", "dist/index.d.ts"} <= files
    assert not [name for name in files if ".test." in name or name.startswith(("src/", "node_modules/"))]
    settings = json.loads((PACKAGE / "package.json").read_text("utf-8"))
    assert "dependencies" not in settings
    for row in settings["exports"].values():
        assert {path.removeprefix("./") for path in row.values()} <= files


def test_it_is_the_only_package_in_the_project(project):
    modules = {path.name for path in (project / "node_modules").iterdir() if not path.name.startswith(".")}
    assert modules == {"adverb-client"}


@pytest.mark.parametrize("readme", READMES, ids=["package", "repository"])
def test_the_first_example_of_a_readme_runs(project, address, readme):
    first = re.findall(r"```js\n(.*?)```", readme.read_text("utf-8"), re.DOTALL)[0]
    assert len(first.strip().splitlines()) <= 6
    (project / "first.js").write_text(first.replace("http://127.0.0.1:8000", address))
    printed = run(NODE, "first.js", cwd=project)
    assert printed.startswith("Float32Array(84) [")


def test_helpers_are_imported_without_their_engines(project):
    names = ("three", "vrm", "babylon")
    script = "".join(f"import {{ applyPose as {name} }} from 'adverb-client/{name}';" for name in names)
    script += f"console.log([{', '.join(names)}].every((each) => typeof each === 'function'))"
    assert run(NODE, "--input-type=module", "--eval", script, cwd=project).strip() == "true"


def test_its_types_are_complete(project):
    compiler = PACKAGE / "node_modules" / "typescript" / "bin" / "tsc"
    if not compiler.exists():
        pytest.skip("the development packages of clients/typescript are not installed")
    options = {"noEmit": True, "strict": True, "module": "nodenext", "target": "es2022", "types": []}
    settings = {"compilerOptions": {**options, "lib": ["es2023", "dom", "dom.iterable"]}, "files": ["uses.ts"]}
    (project / "tsconfig.json").write_text(json.dumps(settings))
    (project / "uses.ts").write_text(USES)
    run(NODE, str(compiler), "-p", ".", cwd=project)
