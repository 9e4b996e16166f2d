"""The jitter buffer and the two clocks, on a simulated clock."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from adverb_client import Clock, Delays, JitterBuffer, Lateness, Record
from adverb_client.records import LAST

STEP = 1.0 / 60.0
SERVER = 1_700_000_000.0  # server time at client time 0
TRANSIT = 0.03


def turn(angle: float) -> np.ndarray:
    return np.float32([[0.0, math.sin(angle / 2), 0.0, math.cos(angle / 2)]])


def record(t: float, *, flags: int = 0, error: float = math.nan, rate: float = 1.0) -> Record:
    """A root that goes along x at 1 m/s, a joint that turns at 1 rad/s, a loop of 2 s."""
    root = np.float32([rate * t, 0.0, 0.0])
    return Record(0, flags, 1, (t / 2.0) % 1.0, t % 2.0, error, 2.0, root, turn(t), None)


class Line:
    """A network: frames with a delay each, a buffer, and a display at 60 Hz."""

    def __init__(self, delays: Delays | None = None, quantile: float = 0.98):
        self.lateness = Lateness(quantile=quantile)
        self.buffer = JitterBuffer(self.lateness, STEP, delays)
        self.buffer.looping = True
        self.irregular = False
        self.coming: list[tuple[float, float, Record]] = []

    def send(self, k: int, late_s: float = 0.0, **kw):
        t = k * STEP
        self.coming.append((t + TRANSIT + late_s, SERVER + t, record(t, **kw)))
        self.coming.sort(key=lambda row: row[0])

    def arrive(self, now: float):
        while self.coming and self.coming[0][0] <= now:
            at, due, frame = self.coming.pop(0)
            self.lateness.add(at, due)
            self.buffer.push(due, frame, irregular=self.irregular)

    def show(self, times):
        found = []
        for now in times:
            self.arrive(now)
            found.append(self.buffer.sample(now))
        return found


def times(first: float, last: float) -> list[float]:
    return np.arange(first, last, STEP).tolist()


def test_there_is_no_pose_before_the_first_frame():
    assert Line().buffer.sample(1.0) is None


def test_on_a_perfect_line_the_delay_is_one_interval_and_motion_is_exact():
    line = Line()
    for k in range(120):
        line.send(k)
    for now, sample in zip(times(0.5, 1.9), line.show(times(0.5, 1.9)), strict=True):
        assert sample.delay_s == pytest.approx(STEP, abs=1e-6)
        shown = now - TRANSIT - STEP
        assert sample.server_time_s - SERVER == pytest.approx(shown, abs=1e-6)
        assert sample.root[0] == pytest.approx(shown, abs=1e-5)
        np.testing.assert_allclose(sample.rotations, turn(shown), atol=1e-5)
        assert sample.extrapolated_s == 0.0
        assert not sample.held


def test_rotations_are_interpolated_at_constant_speed():
    line = Line()
    line.send(0)
    line.coming.append((TRANSIT + 0.1, SERVER + 0.1, record(2.0)))  # 2 rad in one step
    line.arrive(0.2)
    for share in np.linspace(0.0, 1.0, 11):
        sample = line.buffer._between(SERVER + 0.1 * share, 0.0)
        np.testing.assert_allclose(sample.rotations, turn(2.0 * share), atol=1e-6)


def test_the_delay_follows_the_measured_lateness():
    line, rng = Line(Delays(max_s=0.3)), random.Random(5)
    for k in range(1800):
        line.send(k, rng.uniform(0.0, 0.08) if k < 600 else 0.0)
    early = line.show(times(0.1, 9.9))
    late = line.show(times(9.9, 29.9))
    assert 0.08 < early[-1].delay_s < 0.08 + 2 * STEP
    assert late[-1].delay_s == pytest.approx(STEP, abs=1e-4)
    settled = early[300:]
    assert sum(sample.extrapolated_s > 0 for sample in settled) < 0.03 * len(settled)


def test_display_time_is_monotonic_and_its_rate_bounded():
    line, rng = Line(), random.Random(6)
    for k in range(900):
        line.send(k, rng.expovariate(1 / 0.02))
    shown = [sample.server_time_s for sample in line.show(times(0.2, 14.5))]
    steps = np.diff(shown)
    assert steps.min() >= 0.79 * STEP
    assert steps.max() <= 1.11 * STEP


def test_the_delay_stays_within_its_bounds():
    line, rng = Line(Delays(min_s=0.05, max_s=0.1)), random.Random(7)
    for k in range(300):
        line.send(k)
    assert line.show(times(0.2, 4.9))[-1].delay_s == pytest.approx(0.05, abs=1e-6)
    for k in range(300, 900):
        line.send(k, rng.uniform(0.0, 0.5))
    assert line.show(times(5.0, 14.0))[-1].delay_s == pytest.approx(0.1, abs=1e-3)


def test_lost_frames_are_interpolated():
    line = Line()
    for k in range(120):
        if k % 3:
            line.send(k)
    for now, sample in zip(times(0.6, 1.8), line.show(times(0.6, 1.8)), strict=True):
        assert sample.root[0] == pytest.approx(now - TRANSIT - sample.delay_s, abs=1e-5)


def test_frames_that_a_budget_leaves_out_delay_the_display_instead_of_extrapolation():
    for irregular in (True, False):
        line = Line()
        line.irregular = irregular
        for k in range(0, 240, 8):  # 7.5 frames a second
            line.send(k)
        shown = times(2.0, 3.8)
        samples = line.show([*times(0.1, 2.0), *shown])[-len(shown) :]
        assert any(sample.extrapolated_s > 0.0 for sample in samples) is not irregular
        if irregular:
            assert [sample.delay_s for sample in samples] == pytest.approx([8 * STEP] * len(samples), abs=2e-3)
            at = [sample.server_time_s - SERVER for sample in samples]
            assert [float(sample.root[0]) for sample in samples] == pytest.approx(at, abs=1e-5)


def test_reordered_frames_are_sorted_and_duplicates_counted():
    line = Line(Delays(min_s=0.1))
    for k in range(60):
        line.send(k, 0.04 if k % 2 else 0.0)
    line.send(30)
    line.show(times(0.1, 1.0))
    assert line.buffer.duplicates == 1
    assert line.buffer._times == sorted(line.buffer._times)
    assert line.buffer.late == 0


def test_frames_after_their_display_time_are_counted():
    line = Line()
    for k in range(30):
        line.send(k, 0.5 if k == 20 else 0.0)
    line.show(times(0.1, 0.9))
    assert line.buffer.late == 1


def test_without_frames_motion_is_extrapolated_and_then_held():
    line = Line(Delays(extrapolate_s=0.1))
    for k in range(60):
        line.send(k)
    end = 59 * STEP
    samples = line.show(times(0.5, 3.0))
    beyond = [sample for sample in samples if sample.extrapolated_s > 0]
    moving = [sample for sample in beyond if not sample.held]
    holding = [sample for sample in beyond if sample.held]
    assert 5 <= len(moving) <= 7
    for sample in moving:
        assert sample.root[0] == pytest.approx(end + sample.extrapolated_s, abs=1e-4)
        np.testing.assert_allclose(sample.rotations, turn(end + sample.extrapolated_s), atol=1e-4)
    for sample in holding:
        assert sample.root[0] == pytest.approx(end + 0.1, abs=1e-4)


def test_an_ended_motion_is_not_extrapolated():
    line = Line()
    for k in range(31):
        line.send(k, flags=LAST if k == 30 else 0)
    sample = line.show([0.4, 0.8])[-1]
    assert sample.ended
    assert sample.root[0] == pytest.approx(30 * STEP, abs=1e-6)


@pytest.mark.parametrize("lost", [False, True])
def test_a_motion_has_ended_until_its_phase_changes_also_where_the_flagged_frame_is_lost(lost):
    line = Line()
    line.buffer.looping = False
    for k in range(60):
        phase = min(k / 30.0, 1.0) if k < 50 else 0.1
        flags = LAST if k == 30 else 0
        if k == 30:
            line.buffer.end()
        if not (lost and k == 30):
            line.lateness.add(k * STEP + TRANSIT, SERVER + k * STEP)
            line.buffer.push(SERVER + k * STEP, replace(record(k * STEP, flags=flags), phase=phase))
    ended = [bool(one.flags & LAST) for one in line.buffer._records]
    assert ended == [False] * 30 + [True] * (19 if lost else 20) + [False] * 10
    assert line.buffer._between(SERVER + 40 * STEP, 0.0).ended
    assert not line.buffer._between(SERVER + 55 * STEP, 0.0).ended


def test_there_is_no_extrapolation_across_a_gap():
    line = Line()
    for k in (0, 1, 2, 20):
        line.send(k)
    line.arrive(1.0)
    assert line.buffer._between(SERVER + 21 * STEP, 0.0).root[0] == pytest.approx(20 * STEP, abs=1e-6)


def test_phase_interpolation_wraps_at_the_end_of_a_loop():
    line = Line()
    for k in range(240):
        line.send(k)
    phases = np.array([sample.phase for sample in line.show(times(0.5, 3.9))])
    steps = np.diff(phases) % 1.0
    np.testing.assert_allclose(steps, STEP / 2.0, atol=1e-5)
    assert ((phases >= 0) & (phases < 1)).all()


def test_sampling_an_earlier_instant_changes_no_state():
    line = Line()
    for k in range(60):
        line.send(k)
    first = line.show([0.8])[0]
    before = line.buffer.sample(0.7)
    assert before.server_time_s == pytest.approx(first.server_time_s - 0.1, abs=1e-6)
    assert line.buffer.sample(0.8).server_time_s == first.server_time_s


def test_after_a_restart_the_old_pose_is_held_until_the_first_new_frame():
    line = Line()
    for k in range(60):
        line.send(k)
    line.show(times(0.5, 1.0))
    line.buffer.restart()
    line.lateness.clear()
    held = line.buffer.sample(5.0)
    assert held.held
    assert held.root[0] == pytest.approx(58 * STEP + 0.1, abs=0.02)
    line.lateness.add(5.1, 77.0)
    line.buffer.push(77.0, record(9.0))
    assert len(line.buffer) == 1
    assert line.buffer.sample(5.1).root[0] == pytest.approx(9.0)


def test_errors_are_interpolated_only_where_both_are_known():
    line = Line()
    line.send(0, error=0.2)
    line.send(1, error=0.4)
    line.send(2)
    line.arrive(1.0)
    assert line.buffer._between(SERVER + 0.5 * STEP, 0.0).error == pytest.approx(0.3, abs=1e-4)
    assert line.buffer._between(SERVER + 1.2 * STEP, 0.0).error == pytest.approx(0.4, abs=1e-4)
    assert math.isnan(line.buffer._between(SERVER + 1.8 * STEP, 0.0).error)


def test_weights_are_interpolated_unless_their_number_changes():
    buffer = JitterBuffer(Lateness(), STEP)
    for k, weights in enumerate(([1.0, 0.0], [0.0, 1.0], [0.2, 0.3, 0.5])):
        buffer.push(k * STEP, Record(0, 0, 1, 0.0, 0.0, 0.0, 1.0, None, None, np.float32(weights)))
    np.testing.assert_allclose(buffer._between(0.25 * STEP, 0.0).weights, [0.75, 0.25], atol=1e-6)
    assert len(buffer._between(1.75 * STEP, 0.0).weights) == 3
    assert buffer._between(0.5 * STEP, 0.0).root is None


def test_the_ping_with_the_shortest_round_trip_gives_the_offset():
    clock, rng = Clock(), random.Random(8)
    assert math.isnan(clock.offset_s)
    for k in range(50):
        out, back = 0.01 + rng.expovariate(1 / 0.05), 0.01 + rng.expovariate(1 / 0.05)
        sent = float(k)
        clock.add(sent, sent + out + back, round((SERVER + sent + out) * 1e9))
    assert clock.offset_s == pytest.approx(SERVER, abs=clock.round_trip_s / 2 + 1e-6)
    assert clock.round_trip_s < 0.06
    assert clock.age_s(100.0, SERVER + 99.9) == pytest.approx(0.1, abs=0.03)


def test_old_pings_are_discarded():
    clock = Clock(window_s=60.0)
    clock.add(0.0, 0.001, round(SERVER * 1e9))
    clock.add(100.0, 100.2, round((SERVER + 0.5 + 100.1) * 1e9))
    assert clock.offset_s == pytest.approx(SERVER + 0.5, abs=1e-6)
    clock.add(200.0, 199.0, 0)  # a clock that went backwards is ignored
    assert clock.round_trip_s == pytest.approx(0.2)


def test_lateness_is_relative_to_the_smallest_recent_transit():
    lateness = Lateness(window=10, quantile=0.5)
    assert lateness.measured() is None
    for k in range(10):
        lateness.add(100.0 + k + 0.01 * k, float(k))
    ground, late = lateness.measured()
    assert ground == pytest.approx(100.0)
    assert late == pytest.approx(0.05)
    for k in range(10):
        lateness.add(200.0 + k, float(k))
    assert lateness.measured() == pytest.approx((200.0, 0.0))
