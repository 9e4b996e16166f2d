"""Refinement for quality: exact verbs that move better."""

from verbs.refine_quality.judge import Comparison, Figures, compare
from verbs.refine_quality.loop import START, Costs, Mark, Rules, Step, check, refine, resume, with_basis

__all__ = [
    "START", "Comparison", "Costs", "Figures", "Mark", "Rules", "Step", "check", "compare", "refine", "resume",
    "with_basis",
]  # fmt: skip
