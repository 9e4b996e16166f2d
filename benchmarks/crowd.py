"""A crowd at one phase in single precision, against what the machine's arithmetic and memory allow in the same run."""

from __future__ import annotations

import numpy as np

from benchmarks.timing import interleave
from verbs.kernels.crowd import TILE, crowd

BATCH, EXAMPLES, JOINTS = 1_000, 24, 60
GOAL = 0.5
SQUARE = 1_024
COPIED_BYTES = 64 * 1024 * 1024


def _arguments(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Weights, rows, references, parents, offsets, and room for what is written."""
    references = rng.normal(size=(JOINTS, 4))
    references /= np.linalg.norm(references, axis=1, keepdims=True)
    turns = references + 0.2 * rng.normal(size=(EXAMPLES, JOINTS, 4))
    rows = np.zeros((EXAMPLES, 4 + 4 * JOINTS))
    rows[:, 4:] = (turns / np.linalg.norm(turns, axis=2, keepdims=True)).reshape(EXAMPLES, -1)
    weights = rng.dirichlet(np.ones(EXAMPLES), BATCH)
    parents = np.array([-1, *(max(0, j - 1 - j % 3) for j in range(1, JOINTS))], np.int64)
    single = [a.astype(np.float32) for a in (weights, rows, references, 0.1 * rng.normal(size=(JOINTS, 3)))]
    tiles = -(-BATCH // TILE)
    written = [np.zeros((tiles, JOINTS, width, TILE), np.float32) for width in (4, 3)]
    return (*single[:3], parents, single[3], *written)


def main() -> None:
    """Print one table."""
    rng = np.random.default_rng(0)
    arguments = _arguments(rng)
    weights, rows = arguments[:2]
    columns, characters, sums = rows.T.copy(), weights.T.copy(), np.zeros((rows.shape[1], BATCH), np.float32)
    square = rng.normal(size=(SQUARE, SQUARE)).astype(np.float32)
    product = np.zeros_like(square)
    source = np.ones(COPIED_BYTES // 4, np.float32)
    target = np.zeros_like(source)
    best = interleave(
        {
            "crowd": lambda: crowd(*arguments),
            "product": lambda: np.dot(columns, characters, out=sums),
            "sgemm": lambda: np.dot(square, square, out=product),
            "copy": lambda: np.copyto(target, source),
        },
        rounds=160,
    )
    flops = 2 * EXAMPLES * rows.shape[1]
    written = 4 * 7 * JOINTS
    gflops = 2e-9 * SQUARE**3 / best["sgemm"]
    rate = 2e-9 * COPIED_BYTES / best["copy"]  # both the bytes read and those written count, as in STREAM
    arithmetic, memory = 1e-3 * flops / gflops, 1e-3 * written / rate
    taken, bound = 1e6 * best["crowd"] / BATCH, max(arithmetic, memory)
    print(f"crowd: {BATCH:,} characters at one phase, {EXAMPLES} examples, {JOINTS} joints, float32")
    print(f"  {'pose, joint positions included':<36}{taken:>10.3f} µs each")
    print(f"  {'its matrix product alone':<36}{1e6 * best['product'] / BATCH:>10.3f} µs each")
    print(f"  {'bound by sgemm':<36}{arithmetic:>10.3f} µs each: {flops / 1e3:.1f} kflop at {gflops:.0f} GFLOP/s")
    print(f"  {'bound by memory':<36}{memory:>10.3f} µs each: {written / 1e3:.2f} kB written at {rate:.1f} GB/s")
    verdict = "met" if bound / taken >= GOAL else "not met"
    print(f"  share of the higher bound: {bound / taken:.2f} (goal ≥ {GOAL}: {verdict})")


if __name__ == "__main__":
    main()
