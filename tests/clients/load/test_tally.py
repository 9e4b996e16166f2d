"""Statistics: lateness on two clocks, gaps that are reported and gaps that are not."""

import math
from array import array

import pytest
from adverb_load.tally import Clock, Tally, Track, lateness_of

MS = 1_000_000


def test_the_quickest_ping_is_believed():
    clock = Clock()
    clock.add(1_000, 9_000, 105_000)
    clock.add(20_000, 20_200, 120_100)
    clock.add(30_000, 39_000, 130_000)
    assert clock.offset_ns == 100_000
    assert clock.round_trip_ns == 200


def test_a_ping_that_came_before_it_was_sent_does_not_count():
    clock = Clock()
    clock.add(10, 5, 1_000)
    assert clock.round_trip_ns is None
    assert clock.offset_ns == 0


def test_lateness_is_arrival_minus_due_time_on_one_clock():
    ahead = 5_000 * MS  # the server's clock
    late = array("q", [k * MS - ahead for k in range(101)])
    found = lateness_of(late, ahead)
    assert (found.p50, found.p95, found.p99, found.max) == (50.0, 95.0, 99.0, 100.0)


def test_nothing_has_no_lateness():
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
def test_gaps_count_where_they_are_not_reported(steps, missing, reported):
    track = Track()
    found = [track.step(*step) for step in steps]
    assert (sum(one for one, _ in found), sum(more for _, more in found)) == (missing, reported)


def test_numbers_go_round():
    track = Track(2**32 - 1, 2**32 - 1)
    assert track.step(0, 1) == (0, 2)


def test_only_what_is_due_within_the_window_counts_for_lateness_and_loss():
    tally = Tally()
    tally.message(50, 60, 3, 100)
    tally.window(100, 200)
    for due in (99, 100, 199, 200):
        tally.message(due, due + 7, 3, 100)
        tally.lost(due, 1, 2)
    assert list(tally.late_ns) == [7, 7]
    assert (tally.delivered, tally.records, tally.payload_bytes, tally.dropped) == (2, 6, 200, 4)
    assert (tally.messages, tally.gaps) == (5, 4)


def test_all_faults_are_counted_and_a_few_are_kept():
    tally = Tally()
    for k in range(50):
        tally.fault(f"fault {k}")
    assert tally.wrong == 50
    assert tally.problems[0] == "fault 0"
    assert len(tally.problems) == 8
