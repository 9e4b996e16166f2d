"""The npm package in an empty project: installation, types, and the examples of its README."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import pytest

from tests.clients.typescript.node import NODE, PACKAGE, PROJECT
from tests.service.catalog.conftest import PATIENCE_S as START_S
from tests.service.catalog.conftest import Kept

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


# What surrounds an example of the package's README: declarations of the names that it takes for granted, and a check.
ANY_SERVER = re.compile(r"http://127\.0\.0\.1:8000|https://motion\.example")
GOAL = "const goal = { x: -0.3, y: 1.2, z: 0.4 };"
EVALUATED = f"""
import {{ Client, Evaluator }} from "adverb-client";
{GOAL}
const rest = new Client("http://127.0.0.1:8000");
const pose = (await Evaluator.load(await rest.verbFile("reach"))).pose(goal);
"""
EXAMPLES = {
    ("Stream", 0): (
        """
import { connect } from "adverb-client";
const key = null;
const requestAnimationFrame = (then) => setTimeout(() => then(performance.now()), 16);
const draw = (positions) => {
  console.log("drawn", positions.every(Number.isFinite));
  process.exit();
};
""",
        "",
        "drawn true",
    ),
    ("REST", 0): (
        f"""
import {{ Client, Sequence }} from "adverb-client";
{GOAL}
const [key, adverbs] = [null, goal];
""",
        "console.log(rotations.length, error < 0.01, motion.first.phase, drafts.drafts);",
        "28 true 0 []",
    ),
    ("Evaluator", 0): (
        """
import { Client, Evaluator } from "adverb-client";
const client = new Client("http://127.0.0.1:8000");
""",
        "console.log(pose.values.every((value, k) => Math.abs(value - same.values[k]) < 1e-6));",
        "true",
    ),
    ("Engines", 0): (
        f"""{EVALUATED}
const bone = (name, parent, y) => ({{
  name, parent, children: [], scale: {{ x: 1 }},
  position: {{ x: 0, y, z: 0, set(...to) {{ [this.x, this.y, this.z] = to; }} }},
  quaternion: {{ x: 0, y: 0, z: 0, w: 1, set(...to) {{ [this.x, this.y, this.z, this.w] = to; }} }},
}});
const pelvis = bone("pelvis", null, 1);
const arm = bone("upperarm_l", pelvis, 0.5);
pelvis.children.push(arm);
const skinnedMesh = {{ skeleton: {{ bones: [pelvis, arm] }} }};
""",
        "console.log(arm.quaternion.w < 1, pelvis.position.y > 0.1);",
        "true true",
    ),
    ("Engines", 1): (
        f"""{EVALUATED}
const {{ names, parents, offsets }} = pose.skeleton;
const low = Math.min(...names.map((_, k) => {{
  let y = 0;
  for (let j = k; j > 0; j = parents[j]) y += offsets[j][1];
  return y;
}}));
const joints = names.map((name, k) => (
  {{ name, parent: parents[k], rotation: [0, 0, 0, 1], position: k === 0 ? [0, -low, 0] : offsets[k] }}
));
const written = [];
const write = (joint, turn) => written.push(joint.name, turn.length);
""",
        "console.log(written.length > 20, mapper.figures.effector < 0.02, mapper.figures.feet < 0.02);",
        "true true true",
    ),
}


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


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A server with all verbs and a store."""
    server = Kept(data=tmp_path_factory.mktemp("kept"), refiners=0).start(START_S)
    yield f"http://127.0.0.1:{server.port}"
    server.stop()


def test_every_example_is_run():
    sections = re.split(r"^## ", READMES[0].read_text("utf-8"), flags=re.MULTILINE)[1:]
    found = {(text.split("\n", 1)[0], k) for text in sections for k, _ in enumerate(re.findall(r"```js\n", text))}
    assert found == set(EXAMPLES)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: f"{example[0]}-{example[1]}")
def test_examples_run(project, kept, example):
    (heading, number), (before, after, printed) = example, EXAMPLES[example]
    section = READMES[0].read_text("utf-8").split(f"\n## {heading}\n")[1].split("\n## ")[0]
    block = re.findall(r"```js\n(.*?)```", section, re.DOTALL)[number]
    (project / "example.js").write_text(ANY_SERVER.sub(kept, f"{before}\n{block}\n{after}\n"))
    assert printed in run(NODE, "example.js", cwd=project)


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
