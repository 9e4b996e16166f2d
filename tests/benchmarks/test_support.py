"""Support predicts how far a motion is from the captured one."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from benchmarks import support


@pytest.mark.parametrize("name", ["kick", "reach"])
def test_support_ranks_motions_that_were_left_out(verb_of, name):
    table = support.left_out(verb_of(name), several=True)
    angle, distance = table[:, -2], table[:, -1]
    ranks = {name: spearmanr(table[:, k], angle).statistic for k, name in enumerate(support.PREDICTORS)}
    assert ranks["support: V"] > 0.6
    assert ranks["support: V"] > max(ranks["Σ|w|"], ranks["power function"])
    assert spearmanr(table[:, support.PREDICTORS.index("support: V")], distance).statistic > 0.5


def test_several_examples_are_left_out_at_once():
    rounds = list(support.splits(12, several=True))
    assert [len(np.unique(held)) for held in rounds] == [4] * support.ROUNDS
    assert [held.tolist() for held in support.splits(3, several=False)] == [[0], [1], [2]]
