import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs.sources import arm_source
from verbs import library
from verbs.authoring.basis import smooth
from verbs.authoring.fit import build
from verbs.cli import app
from verbs.domain import random_points
from verbs.errors import SourceError
from verbs.quality import leave_one_out
from verbs.runtime.evaluate import Evaluator


def source_with(folder, line):
    shutil.copytree(Path(library.__file__).parent / "arm3", folder)
    file = folder / "verb.toml"
    file.write_text(line + "\n" + file.read_text())
    return folder


def test_a_constant_tail_is_exact_too_and_gives_other_weights(tmp_path):
    affine, constant = library.load("arm3"), build(source_with(tmp_path / "c", 'tail = "constant"')).verb
    assert (affine.bases["smooth"].degree, constant.bases["smooth"].degree) == (1, 0)
    goals = random_points(affine, np.random.default_rng(0), 50)
    one, other = (Evaluator(verb).blend(goals) for verb in (affine, constant))
    assert other.error.max() < 1e-9
    assert np.abs(one.weights - other.weights).max() > 1e-3
    np.testing.assert_allclose(Evaluator(constant).blend(constant.values).weights, np.eye(9), atol=1e-9)
    with pytest.raises(SourceError, match="tail"):
        build(source_with(tmp_path / "w", 'tail = "cubic"'))


def test_subsets_keep_the_tail():
    verb = library.load("arm3")
    constant = replace(verb, bases={**verb.bases, "smooth": smooth(verb.domain.chart, verb.values, degree=0)})
    assert leave_one_out.subset(constant, np.arange(8)).bases["smooth"].degree == 0
    assert leave_one_out.subset(verb, np.arange(8)).bases["smooth"].degree == 1


def test_a_tail_is_suggested_only_where_it_predicts_better(monkeypatch, tmp_path):
    verb = library.load("arm3")
    assert leave_one_out.suggested_tail(verb) == "", "0.9 % are not enough"
    monkeypatch.setattr(leave_one_out, "TAIL_GAIN", 0.005)
    assert 'tail = "constant"' in leave_one_out.suggested_tail(verb)
    constant = replace(verb, bases={**verb.bases, "smooth": smooth(verb.domain.chart, verb.values, degree=0)})
    assert leave_one_out.suggested_tail(constant) == ""
    arguments = ["build", str(Path(library.__file__).parent / "arm3"), "-o", str(tmp_path / "a.verb")]
    (suggested,) = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)["suggestions"]
    assert suggested == leave_one_out.suggested_tail(verb)
    assert "suggestion: with tail" in CliRunner().invoke(app, arguments).stdout


def test_verbs_with_too_few_examples_get_no_suggestion(tmp_path):
    styled = replace(library.load("arm3"), bases={"rbf": library.load("arm3").bases["rbf"]})
    assert leave_one_out.suggested_tail(styled) == ""
    small = build(arm_source(tmp_path / "arm")).verb
    some = leave_one_out.subset(small, np.arange(3)) if len(small.examples) > 3 else small
    assert leave_one_out.suggested_tail(some) == ""


def test_the_captured_kick_is_better_with_a_constant_tail(mocap, verb_of):
    assert 'tail = "constant"' in leave_one_out.suggested_tail(verb_of("kick"))
    assert leave_one_out.suggested_tail(verb_of("punch")) == ""
