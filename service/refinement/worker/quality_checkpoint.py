"""Checkpoint of a refinement for quality: its state between the attempts of a job."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from service.refinement.worker.checkpoint import decode, encode
from verbs.refine_quality import START, Mark, Rules, resume
from verbs.verb import Basis, Verb

__all__ = ["QualityCheckpoint", "resume_quality"]


@dataclass(frozen=True, slots=True, eq=False)
class QualityCheckpoint:
    """State of a refinement for quality between two attempts.

    Parameters
    ----------
    basis : Basis
    mark : Mark
    curve : tuple of tuples
        (pseudo-examples, mean cost, 95th percentile of the cost) at the start and after each pseudo-example.
    """

    basis: Basis
    mark: Mark
    curve: tuple[tuple[int, float, float], ...]

    @classmethod
    def start(cls, verb: Verb) -> QualityCheckpoint:
        """Checkpoint before the first evaluation, with the basis ``smooth``."""
        return cls(verb.bases["smooth"], START, ())

    @property
    def steps(self) -> int:
        """Number of attempts so far."""
        return max(self.mark.number, 0)

    @property
    def stopped(self) -> str:
        """Why the refinement is finished; empty while it is not."""
        return self.mark.stopped

    def to_bytes(self) -> bytes:
        """Encode as a safetensors file; equal checkpoints give equal bytes."""
        return encode(self.basis, {"mark": asdict(self.mark), "curve": self.curve})

    @classmethod
    def from_bytes(cls, data: bytes) -> QualityCheckpoint:
        """Decode the result of :meth:`to_bytes`."""
        basis, facts = decode(data)
        mark = Mark(**facts["mark"] | {"tried": tuple(facts["mark"]["tried"])})
        return cls(basis, mark, tuple((int(n), mean, p95) for n, mean, p95 in facts["curve"]))

    def progress(self) -> dict[str, Any]:
        """Progress as JSON values."""
        pseudo, mean, p95 = self.curve[-1] if self.curve else (0, None, None)
        return {
            "pseudo": pseudo, "cost_mean": mean, "cost_p95": p95, "failed": self.mark.failed, "note": "",
            "curve": [list(row) for row in self.curve],
        }  # fmt: skip


def resume_quality(
    verb: Verb, checkpoint: QualityCheckpoint, rules: Rules, *, should_stop: Callable[[], bool]
) -> QualityCheckpoint:
    """Refine from a checkpoint until finished or ``should_stop()``; at least one attempt.

    ``should_stop`` is called after every attempt.
    """
    for step in resume(verb, checkpoint.basis, checkpoint.mark, rules):
        curve = checkpoint.curve
        if not curve or step.pseudo > curve[-1][0]:
            curve = (*curve, (step.pseudo, step.after.mean, step.after.p95))
        checkpoint = QualityCheckpoint(step.basis, step.mark, curve)
        if should_stop():
            break
    return checkpoint
