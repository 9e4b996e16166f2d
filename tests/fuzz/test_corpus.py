"""Every target stays within its contract: for all kept inputs, and for seeds that Hypothesis damages."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzz import bounds
from tests.fuzz.targets import TARGETS

CORPUS = Path(__file__).parent / "corpus"
MAX_BYTES = 2 * 1024 * 1024

PIECES = st.binary(min_size=1, max_size=8) | st.sampled_from(
    [b"", b"\0" * 8, b"\xff" * 8, b"-1", b"1e999", b"NaN", b"null", b"[" * 2_000, b"9" * 5_000, b"\xc2\xb2", b"\\u0000"]
)


@st.composite
def damaged(draw, seeds):
    """A seed with up to four parts replaced by others, or repeated, or cut off."""
    data = draw(st.sampled_from(seeds))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(data)))
        end = min(start + draw(st.integers(0, 40)), len(data))
        piece = draw(PIECES | st.just(data[start:end] * 3))
        data = data[:start] + piece + (data[end:] if draw(st.integers(0, 9)) else b"")
    return data[: bounds.MAX_INPUT_BYTES]


@pytest.mark.parametrize("name", TARGETS)
def test_kept_and_damaged_inputs_raise_documented_errors_only(name):
    target = TARGETS[name]
    seeds = list(target.first())
    kept = [path.read_bytes() for path in sorted((CORPUS / name).iterdir())]
    assert kept
    with target.open() as run:
        for data in [*seeds, *kept]:
            bounds.run(run, data)

        @settings(max_examples=100, deadline=None, database=None)
        @given(damaged(seeds))
        def check(data):
            bounds.run(run, data)

        check()


def test_the_corpus_is_small_and_has_a_folder_for_each_target():
    assert {path.name for path in CORPUS.iterdir()} == set(TARGETS)
    assert sum(path.stat().st_size for path in CORPUS.rglob("*") if path.is_file()) <= MAX_BYTES


def test_an_input_beyond_the_bounds_is_found(monkeypatch):
    monkeypatch.setattr(bounds, "CPU_S", -1.0)  # clocks may be coarse
    with pytest.raises(bounds.TooSlow):
        bounds.run(sum, bytes(10_000))
    with pytest.raises(MemoryError):
        bounds.run(lambda _: bytearray(2 * bounds.MEMORY_BYTES), b"")
