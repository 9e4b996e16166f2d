"""Records of whole crowds against characters that are stepped one at a time in double precision."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from service.packing import pack, pack_step
from service.wire import CLAMPED, FRAMES, IN_TRANSITION, LAST, Layout, Targets, record
from tests.verbs.plain_characters import Plain, change, plain_pose
from verbs import Characters, Evaluator, library
from verbs.kernels import pose
from verbs.kernels.character_state import PROGRESS
from verbs.runtime.characters import RESTART_S, VERSION_S, Frames
from verbs.runtime.evaluate import Blend

NEAR = 1e-6
STEPS_S = [1 / 60, 1 / 60, 1 / 60, 1 / 24, 0.2]


def goal_of(people: Characters, rng) -> np.ndarray:
    """Adverbs (D,) inside the domain, now and then outside."""
    chart, values = people.verb.domain.chart, people.verb.values
    point = rng.dirichlet(np.full(len(values), 0.3)) @ chart.points(values)
    if rng.random() < 0.15:
        point = people.verb.domain.middle + rng.uniform(1.5, 3.0) * (point - people.verb.domain.middle)
    return chart.adverbs(point[None])[0]


class Session:
    """Random acts on characters of some verbs, and on their plain doubles."""

    def __init__(self, troupes: list[Characters], seed: int) -> None:
        self.troupes, self.rng = troupes, np.random.default_rng(seed)
        self.cast: list[tuple[Characters, int, Plain]] = []
        self.seen = dict.fromkeys(("ended", "restarted", "in_transition", "clamped", "followed"), 0)

    def add(self) -> None:
        rng = self.rng
        people = self.troupes[rng.integers(len(self.troupes))]
        goal, looping = goal_of(people, rng), bool(rng.random() < 0.5)
        values = {"phase": float(rng.random()), "speed": float(rng.uniform(-2, 3)), "looping": looping}
        slot = people.add(goal, **values, half_life_s=0.1, plant=False)
        self.cast.append((people, slot, Plain(people, people.goals[slot].copy(), **values)))

    def act(self) -> None:
        rng = self.rng
        k = int(rng.integers(len(self.cast)))
        people, slot, plain = self.cast[k]
        kind = rng.choice(["add", "remove", "aim", "aim", "aim_many", "set", "hold", "go_on", "version"])
        if kind == "add":
            self.add()
        elif kind == "remove" and len(self.cast) > 3:
            people.remove(slot)
            del self.cast[k]
        elif kind == "aim":
            people.goals[slot] = plain.goal = goal_of(people, rng)
        elif kind == "aim_many":
            row = np.frombuffer(goal_of(people, rng).astype(np.float32).tobytes(), np.float32)  # read-only
            people.aim_many(np.array([slot]), row[None])
            plain.goal = row.astype(np.float64)
        elif kind == "set":
            self._set(k, speed=float(rng.uniform(-3, 3)), playing=bool(rng.random() < 0.8))
        elif kind == "hold":
            phase = float(rng.uniform(*people.window)) if people.window else float(rng.random())
            self._set(k, playing=False, **({"phase": phase} if rng.random() < 0.5 else {}))
        elif kind in ("go_on", "version"):
            self._go_on(k, same=kind == "version")

    def _set(self, k: int, **values) -> None:
        people, slot, plain = self.cast[k]
        people.set(slot, **values)
        change(plain, **values)

    def _go_on(self, k: int, *, same: bool) -> None:
        people, slot, plain = self.cast[k]
        other = people if same else self.troupes[self.rng.integers(len(self.troupes))]
        length = VERSION_S if same else float(self.rng.choice([0.0, 0.1, RESTART_S]))
        goal = goal_of(other, self.rng)
        new = other.go_on(people, slot, None if same else goal, transition_s=length, same=same)
        double = plain.go_on(other, other.goals[new].copy(), length, same=same)
        people.remove(slot)
        self.cast[k] = other, new, double

    def step(self) -> None:
        step_s = float(self.rng.choice(STEPS_S))
        for people in self.troupes:
            mine = [(slot, plain) for who, slot, plain in self.cast if who is people]
            if not mine:
                continue
            slots = np.array([slot for slot, _ in mine])
            joints = len(people.verb.skeleton)
            layout = Layout("f32", "local", "gltf", np.arange(joints), 0)
            words = np.zeros(len(mine) * layout.words, np.uint32)
            targets = Targets.of([layout] * len(mine), range(0, len(words), layout.words), range(len(mine)))
            step = pack_step(people, slots, step_s, 7, targets, words)
            rows = words.view(record(joints))
            for b, (_, plain) in enumerate(mine):
                self._compare(step, rows[b], b, plain.step(step_s), plain.share)

    def _compare(self, step, row, b: int, expected: dict, share: float) -> None:
        for name in ("phase", "time_s", "duration_s", "start", "stop"):
            assert step.progress[name][b] == pytest.approx(expected[name], abs=1e-9), name
        for name in ("passed", "ended", "restarted"):
            assert step.progress[name][b] == expected[name], name
            if name in self.seen:
                self.seen[name] += expected[name]
        flags = CLAMPED * expected["clamped"] | IN_TRANSITION * expected["in_transition"] | LAST * expected["ended"]
        assert row["flags"] == flags
        assert (row["channel"], row["version"]) == (b, 7)
        np.testing.assert_allclose(step.error[b], expected["error"], atol=1e-9)
        numbers = [expected[name] for name in ("phase", "time_s", "error", "duration_s")]
        np.testing.assert_allclose(row[["phase", "time", "error", "duration"]].tolist(), numbers, rtol=1e-6, atol=NEAR)
        np.testing.assert_allclose(row["root"], expected["root"], rtol=1e-6, atol=NEAR)
        signs = np.sign((row["rotations"] * expected["rotations"]).sum(axis=-1, keepdims=True))
        assert (signs == 1.0).all()
        np.testing.assert_allclose(row["rotations"], expected["rotations"], atol=NEAR)
        for name in ("in_transition", "clamped"):
            self.seen[name] += expected[name]
        self.seen["followed"] += share > 0


@pytest.fixture(scope="module")
def captured(verb_of):
    return lru_cache(maxsize=None)(lambda name: Evaluator(verb_of(name)))


@pytest.mark.parametrize(
    ("names", "seed"),
    [(("reach", "punch"), 1), (("kick", "reach"), 2), (("locomotion", "reach"), 3), (("jump", "locomotion"), 4)],
)
def test_random_sessions_are_those_of_single_characters(captured, names, seed):
    session = Session([Characters(captured(name)) for name in names], seed)
    for _ in range(6):
        session.add()
    for _ in range(240):
        if session.rng.random() < 0.35:
            session.act()
        session.step()
    assert session.seen["ended"] > 0
    assert session.seen["in_transition"] > 20
    assert session.seen["clamped"] > 0
    assert session.seen["followed"] > 0 or "reach" not in names
    assert session.seen["restarted"] > 0
    left = [people for people, _, _ in session.cast]
    assert [len(people) for people in session.troupes] == [left.count(people) for people in session.troupes]


def crowd(count: int, seed: int = 0, *, plant: bool = False) -> tuple[Characters, np.ndarray]:
    people, rng = Characters(Evaluator(library.load("reach"))), np.random.default_rng(seed)
    return people, np.array([people.add(goal_of(people, rng), phase=rng.random(), plant=plant) for _ in range(count)])


@pytest.mark.parametrize("encoding", ["f32", "q48", "q32", "weights"])
@pytest.mark.parametrize("space", ["local", "global"])
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("chosen", [None, [3, 0, 7]])
def test_every_layout_is_that_of_frames(encoding, space, frame, chosen):
    """Records that are written at once are those that :func:`pack` makes of frames."""
    (one, slots), (other, _) = crowd(40), crowd(40)
    joints = np.arange(len(one.verb.skeleton)) if chosen is None else np.array(chosen)
    layout = Layout(encoding, space, frame, joints, len(one.verb.examples))
    targets = Targets.of([layout] * 40, np.arange(40) * layout.words, range(40))
    direct, made = np.zeros((2, 40 * layout.words), np.uint32)
    for _ in range(2):
        slots[-1] = {people.go_on(people, int(slots[-1])) for people in (one, other)}.pop()  # one is in a transition
        pack_step(one, slots, 1 / 30, 1, targets, direct)
        frames = other.step(slots, 1 / 30)
        world = np.empty_like(frames.rotations)
        pose.forward(frames.root, frames.rotations, one.verb.skeleton.parents, one.verb.skeleton.offsets, world,
                     np.empty((40, world.shape[1], 3)))  # fmt: skip
        pack(frames, world, 1, targets, made)
    ours, theirs = direct.reshape(40, -1), made.reshape(40, -1)
    np.testing.assert_array_equal(ours[:, :2], theirs[:, :2])
    numbers = [words[:, 2 : 7 if encoding == "weights" else 9].view(np.float32) for words in (ours, theirs)]
    np.testing.assert_allclose(*numbers, atol=2e-4 if frame == "unreal" else NEAR)
    if encoding in ("f32", "weights"):
        np.testing.assert_allclose(ours[:, 9:].view(np.float32), theirs[:, 9:].view(np.float32), atol=NEAR)
        return
    kind, steps = (np.uint16, [0x7FFF]) if encoding == "q48" else (np.uint32, [0x3FF, 0x3FF << 10, 0x3FF << 20])
    ours, theirs = (np.ascontiguousarray(words[:, 9:]).view(kind).astype(np.int64) for words in (ours, theirs))
    for mask in steps:
        unit = mask & -mask
        assert (np.abs((ours & mask) - (theirs & mask)) <= unit).all()
    rest = ~sum(steps) & np.iinfo(kind).max
    assert ((ours & rest) == (theirs & rest)).all()


def test_planted_records_are_those_of_frames():
    """Legs are solved on single precision there, on double precision here."""
    (one, slots), (other, _) = crowd(70, plant=True), crowd(70, plant=True)
    (plain, _) = crowd(70)
    joints = len(one.verb.skeleton)
    layout = Layout("f32", "local", "gltf", np.arange(joints), 0)
    targets = Targets.of([layout] * 70, np.arange(70) * layout.words, range(70))
    for _ in range(40):
        words = np.zeros(70 * layout.words, np.uint32)
        pack_step(one, slots, 1 / 30, 1, targets, words)
        frames, unplanted = other.step(slots, 1 / 30), plain.step(slots, 1 / 30)
        rows = words.view(record(joints))
        np.testing.assert_allclose(rows["rotations"], frames.rotations, atol=1e-4)
        np.testing.assert_allclose(rows["root"], frames.root, atol=1e-5)
        assert np.abs(frames.rotations - unplanted.rotations).max() > 1e-3


@pytest.mark.parametrize("count", [1, 2, 3, 5, 64, 65, 300])
def test_a_record_does_not_depend_on_the_crowd(count):
    people, slots = crowd(300)
    alone, _ = crowd(300)
    layout = Layout("f32", "local", "gltf", np.arange(len(people.verb.skeleton)), 0)
    words = np.zeros((2, count * layout.words), np.uint32)
    targets = Targets.of([layout] * count, np.arange(count) * layout.words, range(count))
    for _ in range(2):
        pack_step(people, slots[:count], 1 / 60, 1, targets, words[0])
        for b in range(count):
            pack_step(alone, slots[b : b + 1], 1 / 60, 1, targets.part(b, b + 1), words[1])
    rows = words.view(np.float32).reshape(2, count, -1)
    np.testing.assert_array_equal(rows[0, :, 6:], rows[1, :, 6:])


def test_without_a_place_a_character_moves_and_nothing_is_written():
    (people, slots), (other, _) = crowd(5), crowd(5)
    layout = Layout("q48", "local", "gltf", np.arange(len(people.verb.skeleton)), 0)
    words = np.full(5 * layout.words, 7, np.uint32)
    step = pack_step(people, slots, 1 / 60, 1, Targets.of([layout] * 5, [-1] * 5, range(5)), words)
    assert (words == 7).all()
    np.testing.assert_array_equal(step.progress, other.step(slots, 1 / 60).progress)


def test_sums_that_cancel_are_the_reference(captured):
    """Weights far outside: some sums are short, and the joint is the reference, as everywhere else."""
    people, slots = crowd(9)
    people.step(slots, 1 / 60)
    rng = np.random.default_rng(2)
    crowd_weights = people.crowd.weights
    crowd_weights[slots] = rng.normal(size=crowd_weights[slots].shape) * 0.02
    layout = Layout("f32", "local", "gltf", np.arange(len(people.verb.skeleton)), 0)
    words = np.zeros(9 * layout.words, np.uint32)
    targets = Targets.of([layout] * 9, np.arange(9) * layout.words, range(9))
    step = pack_step(people, slots, 1 / 60, 1, targets, words)
    weights = crowd_weights[slots, people.state["weights"][slots]]
    verb = people.verb
    rotations = np.array([plain_pose(verb, *one)[1] for one in zip(weights, step.progress["phase"], strict=True)])
    assert (rotations == verb.references).all(axis=-1).sum() > 20
    rows = words.view(record(len(verb.skeleton)))
    np.testing.assert_allclose(rows["rotations"], rotations, atol=1e-5)


def test_rotation_vectors(captured):
    verb = library.load("reach")
    curves = verb.curves.copy()
    curves[:, :, 7::4] = 0.0  # the quaternions' x, y, z are as good as any vectors
    people = Characters(Evaluator(replace(verb, curves=curves, rotation_mode=pose.ROTATION_VECTOR)), "rbf")
    rng = np.random.default_rng(0)
    slots = np.array([people.add(goal_of(people, rng), phase=rng.random(), plant=False) for _ in range(70)])
    layout = Layout("f32", "local", "gltf", np.arange(len(verb.skeleton)), 0)
    words = np.zeros(70 * layout.words, np.uint32)
    pack_step(people, slots, 0.1, 1, Targets.of([layout] * 70, np.arange(70) * layout.words, range(70)), words)
    rows = words.view(record(len(verb.skeleton)))
    weights, phases = people.crowd.weights[slots, people.state["weights"][slots]], people.state["phase"][slots]
    for row, *one in zip(rows, weights, phases, strict=True):
        root, rotations = plain_pose(people.verb, *one)
        np.testing.assert_allclose(row["rotations"], rotations, atol=NEAR)
        np.testing.assert_allclose(row["root"], root, atol=NEAR)


@pytest.mark.parametrize("joints", [1, 4, 23])
def test_three_components_of_ten_bits(joints):
    """Decoded here from the words, as docs/wire.md states them."""
    rng = np.random.default_rng(joints)
    rotations = rng.normal(size=(50, joints, 4))
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    blend = Blend("", np.zeros((50, 1)), np.zeros((50, 0)), np.zeros(50), np.zeros(50, np.bool_))
    frames = Frames(blend, np.zeros(50, PROGRESS), rng.normal(size=(50, 3)), rotations, np.zeros(50, np.bool_))
    layout = Layout("q32", "local", "gltf", np.arange(joints), 1)
    assert 4 * layout.words == 24 + 12 + 4 * joints
    words = np.zeros(50 * layout.words, np.uint32)
    pack(frames, rotations, 1, Targets.of([layout] * 50, np.arange(50) * layout.words, range(50)), words)
    rows = words.reshape(50, -1)
    assert (rows[:, 0] >> 16 & 0xFF == 3).all()
    for row, expected in zip(rows[:, 9:].ravel(), rotations.reshape(-1, 4), strict=True):
        left_out = int(row) >> 30
        three = [((int(row) >> shift & 0x3FF) - 511) / (511 * np.sqrt(2)) for shift in (0, 10, 20)]
        found = np.insert(three, left_out, np.sqrt(max(1 - np.sum(np.square(three)), 0.0)))
        assert left_out == np.abs(expected).argmax()
        np.testing.assert_allclose(found, expected * np.sign(expected[left_out]), atol=2.5e-3)


def test_a_character_takes_less_than_a_page(captured):
    """Bytes of one of many, of 35 examples, 23 joints, 2 feet and 3 adverbs; the library's limit is 4 kB."""
    people = Characters(captured("reach"))
    slots = np.array([people.add() for _ in range(4_096)])
    people.step(slots, 1 / 60)
    arrays = [*people.crowd, people.stored.frames, people.stored.offsets]
    assert (len(people.verb.examples), len(people.verb.skeleton), len(people.verb.adverbs)) == (35, 23, 3)
    assert sum(array.nbytes for array in arrays) / len(slots) < 2_560
    known = {id(array) for array in arrays}
    large = [v for v in vars(people).values() if isinstance(v, np.ndarray) and v.nbytes > len(slots)]
    assert all(id(array) in known for array in large)


def test_frames_are_stored_in_transitions_only():
    people, slots = crowd(20)
    people.step(slots, 1 / 60)
    assert len(people.stored.frames) == 0
    for _ in range(3):
        slots = np.array([people.go_on(people, int(slot), transition_s=0.1) for slot in slots])
        for _ in range(10):
            people.step(slots, 1 / 60)
        assert (people.state["held"][slots] == -1).all()
    assert len(people.stored.frames) <= 32
    held = people.go_on(people, int(slots[0]))
    people.remove(held)
    assert len(set(people.stored.take(len(people.stored.frames)).tolist())) == len(people.stored.frames)
