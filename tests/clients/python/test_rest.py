"""The REST clients against the real app."""

import httpx
import numpy as np
import pytest
from adverb_client import AsyncClient, Client, DecodeError, TimedOut, TransportError, errors

from service.errors import PROBLEMS
from tests.service.conftest import app_of

pytestmark = pytest.mark.anyio

AT = {"x": 0.4, "y": 0.3}
ROW = [0.4, 0.3]


@pytest.fixture
def app(catalog):
    return app_of(catalog)


@pytest.fixture
async def client(app, anyio_backend):
    async with AsyncClient("http://localhost", transport=httpx.ASGITransport(app=app)) as client:
        yield client


async def test_verbs_are_listed_and_described(client):
    rows = await client.verbs()
    arm = next(row for row in rows if row.name == "arm3")
    assert (arm.adverbs, arm.joints, arm.looping) == (("x", "y"), 4, False)
    verb = await client.verb("arm3")
    assert [adverb.name for adverb in verb.adverbs] == ["x", "y"]
    assert verb.skeleton.names == ("Shoulder", "Elbow", "Wrist", "Tip")
    assert verb.keytimes["start"] == 0.0
    assert verb.measure["effector"] == "Tip"
    assert verb.quality["method"] == verb.default_method
    assert await client.verb("arm3") is verb  # the second response is 304


async def test_a_record_and_a_full_response_agree(client):
    short = await client.pose("arm3", AT, phase=0.4807692307692308)
    full = await client.pose("arm3", ROW, phase=0.4807692307692308, full=True)
    np.testing.assert_allclose(short.rotations, full.rotations, atol=1e-7)
    np.testing.assert_allclose(short.root, full.root, atol=1e-7)
    assert (short.verb, short.version, short.clamped) == (full.verb, full.version, full.clamped)
    assert short.time_s == pytest.approx(full.time_s, abs=1e-6)
    assert short.error == pytest.approx(full.error, abs=1e-6)
    assert (short.method, short.measured) == (None, None)
    assert (short.support, full.method) == (None, "corrected")
    assert 0.0 < full.support < 1.0
    assert full.measured == pytest.approx(AT, abs=1e-6)
    verb = await client.verb("arm3")
    np.testing.assert_allclose(verb.skeleton.positions(short.root, short.rotations)[3, :2], ROW, atol=1e-6)


async def test_fields_of_full_responses(client):
    pose = await client.pose("arm3", AT, phase=0.5, weights=True, max_error=1e-3, method="rbf")
    assert pose.weights.sum() == pytest.approx(1.0)
    assert pose.met
    assert pose.tried[0] == "rbf"
    pose = await client.pose("arm3", AT, time_s=0.2, space="global", joints=["Tip"], full=True)
    assert pose.positions.shape == (1, 3)
    assert pose.time_s == pytest.approx(0.2)


async def test_batches_by_rows_columns_and_times(client):
    rng = np.random.default_rng(1)
    rows = np.column_stack([rng.uniform(0.2, 0.7, 50), rng.uniform(-0.3, 0.3, 50)])
    phases = rng.uniform(0, 1, 50)
    crowd = await client.poses("arm3", rows, phases=phases)
    named = await client.poses("arm3", {"x": rows[:, 0], "y": rows[:, 1]}, phases=phases, method="corrected")
    np.testing.assert_array_equal(crowd.rotations, named.rotations)
    assert crowd.rotations.shape == (50, 4, 4)
    one = await client.pose("arm3", np.float32(rows[7]), phase=float(np.float32(phases[7])))
    np.testing.assert_allclose(crowd[7].rotations, one.rotations, atol=1e-6)
    assert crowd[7].error == pytest.approx(one.error, abs=1e-6)
    some = await client.poses("arm3", rows, phases=0.5, joints=["Tip", "Elbow"], space="global")
    assert some.rotations.shape == (50, 2, 4)
    timed = await client.poses("arm3", rows[:3], times_s=[0.0, 0.1, 0.2], weights=True)
    np.testing.assert_allclose(timed.times_s, [0.0, 0.1, 0.2], atol=1e-6)
    assert timed.weights.shape == (3, 9)
    assert timed.support.shape == (3,)
    assert timed[1].support == timed.support[1]
    assert set(timed.measured) == {"x", "y"}
    assert len(list(await client.poses("arm3", {"x": 0.4, "y": [0.1, 0.2]}, times_s=0.1))) == 2


async def test_support_of_records_is_that_of_a_full_response_in_steps(client):
    rows = np.array([[0.4, 0.1], [0.6, -0.2], [0.9, 0.5]])
    full = await client.poses("arm3", rows, phases=0.5, full=True)
    short = await client.poses("arm3", rows, phases=0.5, support=True)
    np.testing.assert_allclose(short.support, full.support, atol=0.5 / 14 + 1e-9)
    assert (await client.poses("arm3", rows, phases=0.5)).support is None
    motion = await client.sequence("arm3", AT, support=True)
    assert motion.support.shape == (len(motion.root),)


async def test_motions_at_constant_adverbs_and_along_a_track(client):
    short = await client.sequence("arm3", AT, fps=60)
    full = await client.sequence("arm3", AT, fps=60, full=True)
    np.testing.assert_allclose(short.rotations, full.rotations, atol=1e-7)
    np.testing.assert_allclose(short.times_s, full.times_s, atol=1e-6)
    assert short.duration_s == pytest.approx(full.duration_s, abs=1e-5)
    assert short.error == pytest.approx(full.error, abs=1e-6)
    assert len(short) == len(full.phases)
    assert [event.name for event in full.events][:1] == ["start"]
    track = [(0.0, AT), (0.5, [0.6, 0.0])]
    binary = await client.sequence("arm3", track=track, joints=["Tip"])
    fields = await client.sequence("arm3", track=track, full=True, weights=True)
    assert binary.rotations.shape == (len(fields), 1, 4)
    assert binary.duration_s == pytest.approx(fields.duration_s, abs=1e-5)
    assert fields.weights.shape == (len(fields), 9)
    assert fields.support.shape == (len(fields),)
    assert np.ptp(fields.support) > np.ptp(full.support) == 0.0
    assert (await client.bvh("arm3", AT)).startswith("HIERARCHY")


async def test_poses_on_another_skeleton(client):
    goal = {"x": -0.3, "y": 1.2, "z": 0.4}
    pose = await client.pose("reach", goal, phase=0.5, map="unreal", map_goal="world")
    assert (pose.mapped.name, pose.mapped.goal) == ("unreal", "world")
    assert pose.rotations.shape == (len(pose.mapped.joints), 4)
    assert pose.mapped.effector_m < 1e-3
    batch = await client.poses("reach", {"x": [-0.3, -0.1], "y": 1.2, "z": 0.4}, phases=[0.5, 0.2], map="smpl")
    assert batch[0].mapped.joints == batch[1].mapped.joints
    assert batch.rotations.shape == (2, 24, 4)
    motion = await client.sequence("reach", goal, map="vrm", joints=["hips", "rightHand"])
    assert motion.mapped.joints == ("hips", "rightHand")
    assert motion.mapped.foot_slide_m < 2e-3
    assert (await client.pose("reach", goal)).mapped is None
    with pytest.raises(errors.UnknownMap) as caught:
        await client.pose("reach", goal, map="robot")
    assert caught.value.known == ("vrm", "unreal", "mixamo", "smpl")


async def test_ready(client):
    assert (await client.health()).verbs >= 3
    assert (await client.wait_ready(1.0)).ready


@pytest.mark.parametrize(
    ("ask", "kind"),
    [
        (lambda c: c.verb("no"), errors.UnknownVerb),
        (lambda c: c.pose("no", AT), errors.UnknownVerb),
        (lambda c: c.pose("arm3", AT, version=99), errors.UnknownVersion),
        (lambda c: c.pose("arm3", {"q": 1.0}), errors.UnknownAdverb),
        (lambda c: c.poses("arm3", {"q": [1.0]}), errors.UnknownAdverb),
        (lambda c: c.pose("arm3", AT, joints=["Nose"]), errors.UnknownJoint),
        (lambda c: c.pose("arm3", AT, method="magic"), errors.UnknownMethod),
        (lambda c: c.pose("arm3", AT, phase=-1.0), errors.InvalidRequest),
        (lambda c: c.poses("arm3", np.zeros((1, 3))), errors.MalformedBody),
        (lambda c: c.poses("arm3", np.zeros((10_001, 2))), errors.BatchTooLarge),
    ],
)
async def test_each_error_response_raises_the_error_of_its_code(client, ask, kind):
    with pytest.raises(kind) as caught:
        await ask(client)
    assert isinstance(caught.value, errors.ResponseError)
    if kind in (errors.UnknownVerb, errors.UnknownAdverb, errors.UnknownJoint, errors.UnknownMethod):
        assert caught.value.known
    if caught.value.status is not None:
        assert caught.value.code == kind.code
        assert caught.value.request_id
    if kind is errors.BatchTooLarge:
        assert caught.value.limit == 10_000
    if kind is errors.InvalidRequest:
        assert caught.value.field_errors[0].at == "phase"


def test_every_code_of_the_server_has_a_class():
    for code in PROBLEMS:
        assert errors.error_class(code) is not errors.ResponseError
        assert errors.error_class(code).code == code
    assert errors.error_class("of tomorrow") is errors.ResponseError


@pytest.mark.parametrize(
    ("ask", "match"),
    [
        (lambda c: c.pose("arm3", [1.0]), "1 adverbs given; 'arm3' has 2: x, y"),
        (lambda c: c.pose("arm3", {"x": float("nan"), "y": 0.0}), "finite"),
        (lambda c: c.poses("arm3", [1.0, 2.0]), "rows"),
        (lambda c: c.poses("arm3", [ROW], phases=0.1, times_s=0.1), "not both"),
        (lambda c: c.sequence("arm3"), "either"),
    ],
)
async def test_invalid_arguments_raise_before_anything_is_sent(client, ask, match):
    with pytest.raises(ValueError, match=match):
        await ask(client)


def test_the_blocking_client_over_a_socket(address):
    with Client(address) as client:
        assert client.wait_ready(5.0).ready
        assert {row.name for row in client.verbs()} >= {"arm3", "reach"}
        assert client.verb("arm3").version == 1
        pose = client.pose("arm3", AT, phase=0.5)
        crowd = client.poses("arm3", [ROW], phases=0.5)  # rows are float32
        np.testing.assert_allclose(crowd.rotations[0], pose.rotations, atol=1e-6)
        assert len(client.sequence("arm3", AT)) > 10
        assert client.bvh("arm3", AT).startswith("HIERARCHY")
        with pytest.raises(errors.ResponseError) as caught:
            client.verb("../livez")
        assert caught.value.status == 404


def answering(*answers: httpx.Response) -> tuple[Client, list[float], list[httpx.Request]]:
    """A client with given responses, its delays and its requests."""
    left, slept, requested = list(answers), [], []

    def handle(request: httpx.Request) -> httpx.Response:
        requested.append(request)
        return left.pop(0)

    return Client("http://a", transport=httpx.MockTransport(handle), sleep=slept.append, api_key="k"), slept, requested


BUSY = {"code": "overloaded", "status": 503, "detail": "busy", "title": "Overloaded"}


def busy(after: str = "1") -> httpx.Response:
    return httpx.Response(503, json=BUSY, headers={"Retry-After": after})


def test_status_503_is_retried_after_the_requested_delay_within_bounds():
    client, slept, requested = answering(busy("1"), busy("3600"), httpx.Response(200, json={"verbs": []}))
    assert client.verbs() == ()
    assert slept == [1.0, 2.0]
    assert requested[0].headers["authorization"] == "Bearer k"


def test_a_server_that_stays_overloaded_is_an_error():
    client, slept, _ = answering(*[busy("nonsense")] * 4)
    with pytest.raises(errors.Overloaded) as caught:
        client.verbs()
    assert caught.value.retry_after_s is None
    assert len(slept) == 3
    client, slept, _ = answering(busy())
    with pytest.raises(errors.Unavailable):
        client.health()
    assert slept == []


def test_wait_ready_repeats_the_request():
    ready = {"ready": True, "verbs": 3, "skipped": [{"file": "a", "problem": "b"}]}
    not_ready = httpx.Response(503, json={"code": "not_ready", "detail": "loading"})
    client, slept, _ = answering(not_ready, httpx.Response(200, json=ready))
    assert client.wait_ready().skipped[0].file == "a"
    assert len(slept) == 1
    client, _, _ = answering(httpx.Response(503, json={"code": "not_ready", "detail": "loading"}))
    with pytest.raises(TimedOut, match="loading"):
        client.wait_ready(0.0)


@pytest.mark.parametrize(
    ("raised", "kind"), [(httpx.ConnectError("no"), TransportError), (httpx.ReadTimeout("late"), TimedOut)]
)
def test_transport_errors_are_errors_of_this_package(raised, kind):
    def handle(_):
        raise raised

    with pytest.raises(kind, match="http://a"):
        Client("http://a", transport=httpx.MockTransport(handle)).verbs()


@pytest.mark.parametrize(
    "response",
    [
        httpx.Response(200, content=b"\xff"),
        httpx.Response(200, json=[]),
        httpx.Response(200, json={"verbs": [{"name": "a"}]}),
    ],
)
def test_a_malformed_response_is_a_decode_error(response):
    with pytest.raises(DecodeError):
        answering(response)[0].verbs()


@pytest.mark.parametrize("content", [b"", bytes(35), bytes(53), b"\xff" * 52, bytes(2) + b"\x01" + bytes(49)])
def test_malformed_records_are_a_decode_error(content):
    with pytest.raises(DecodeError):
        answering(httpx.Response(200, content=content))[0].pose("a", {"x": 1.0})


@pytest.mark.parametrize("content", [b"<html>", b"[]", b'{"errors": 5, "known": {}, "limit": "x"}'])
def test_an_error_response_without_a_problem_document_is_an_error(content):
    with pytest.raises(errors.ResponseError) as caught:
        answering(httpx.Response(502, content=content))[0].verbs()
    assert (caught.value.code, caught.value.status) == ("http_502", 502)
