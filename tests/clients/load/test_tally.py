"""Statistics: lateness across two clocks, reported and unreported gaps."""

import math
from array import array

import pytest
from adverb_client import Clock
from adverb_load.tally import Tally, Track, lateness_of, offset_ns_of

MS = 1_000_000


def test_the_offset_is_that_of_the_clock_in_ns():
    clock = Clock()
    assert offset_ns_of(clock) == 0
    clock.add(1.0, 1.5, 5_250_000_000)
    assert offset_ns_of(clock) == 4_000_000_000


def test_lateness_is_arrival_minus_due_time_on_one_clock():
    ahead = 5_000 * MS  # the server's clock
    late = array("q", [k * MS - ahead for k in range(101)])
    found = lateness_of(late, ahead)
    assert (found.p50, found.p95, found.p99, found.max) == (50.0, 95.0, 99.0, 100.0)


def test_lateness_without_messages_is_nan():
    assert math.isnan(lateness_of(array("q"), 0).p99)


@pytest.mark.parametrize(
    ("steps", "missing", "reported"),
    [
        ([(1, 0), (2, 0), (3, 0)], 0, 0),
        ([(1, 0), (3, 0)], 1, 0),
        ([(1, 0), (2, 5), (3, 5)], 0, 5),  # dropped messages take no numbers
        ([(1, 0), (7, 5), (8, 5)], 0, 5),  # sent and lost with a connection: numbers are missing, and reported
        ([(1, 0), (7, 3)], 2, 3),
        ([(1, 0), (1, 0)], 1, 0),
        ([(5, 4), (3, 4)], 1, 4),
        ([(2, 0)], 1, 0),
    ],
)
def test_unreported_gaps_are_counted(steps, missing, reported):
    track = Track()
    found = [track.step(*step) for step in steps]
    assert (sum(one for one, _ in found), sum(more for _, more in found)) == (missing, reported)


def test_sequence_numbers_wrap():
    track = Track(2**32 - 1, 2**32 - 1)
    assert track.step(0, 1) == (0, 2)


def test_lateness_and_loss_count_within_the_window():
    tally = Tally()
    tally.message(50, 60, 3, 100)
    tally.window(100, 200)
    for due in (99, 100, 199, 200):
        tally.message(due, due + 7, 3, 100)
        tally.lost(due, 1, 2)
    assert list(tally.late_ns) == [7, 7]
    assert (tally.delivered, tally.records, tally.payload_bytes, tally.dropped) == (2, 6, 200, 4)
    assert (tally.messages, tally.gaps) == (5, 4)


def test_faults_are_counted_and_the_first_texts_kept():
    tally = Tally()
    for k in range(50):
        tally.fault(f"fault {k}")
    assert tally.wrong == 50
    assert tally.problems[0] == "fault 0"
    assert len(tally.problems) == 8
