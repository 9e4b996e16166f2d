"""Metrics: the promised names, right numbers, bounded labels."""

import anyio
import numpy as np
import pytest
from prometheus_client import CollectorRegistry, Histogram
from prometheus_client.parser import text_string_to_metric_families

from service.metrics import Metrics, _observe_many
from tests.service.conftest import ARM, SWAY

pytestmark = pytest.mark.anyio


async def samples(client) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    answer = await client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def value(found, name: str, **labels: str) -> float:
    return found[name, tuple(sorted(labels.items()))]


async def test_the_promised_metrics_are_there(client):
    await client.post("/v1/verbs/arm3/pose", json={"adverbs": ARM, "method": "rbf"})
    names = {name for name, _ in await samples(client)}
    for promised in (
        "adverb_request_duration_seconds_bucket",
        "adverb_pose_error_meters_bucket",
        "adverb_poses_total",
        "adverb_clamped_total",
        "adverb_verb_version",
        "adverb_verb_error_meters",
        "adverb_event_loop_lateness_seconds_count",
        "process_resident_memory_bytes",
    ):
        assert promised in names


async def test_poses_errors_and_requests_are_counted(client):
    for x in (0.4, 50.0):
        await client.post("/v1/verbs/arm3/pose", json={"adverbs": {"x": x, "y": 0.3}, "method": "rbf"})
    items = [{"adverbs": {"x": x, "y": 0.3}} for x in (0.3, 0.4, 60.0)]
    await client.post("/v1/verbs/arm3/poses", json={"items": items, "method": "rbf"})
    found = await samples(client)
    assert value(found, "adverb_poses_total", verb="arm3", method="rbf") == 5
    assert value(found, "adverb_clamped_total", verb="arm3") == 2
    assert value(found, "adverb_pose_error_meters_count", verb="arm3", version="1", method="rbf") == 5
    assert value(found, "adverb_pose_error_meters_sum", verb="arm3", version="1", method="rbf") > 100
    route = "/v1/verbs/{verb}/pose"
    assert value(found, "adverb_request_duration_seconds_count", route=route, verb="arm3", method="rbf") == 2
    assert value(found, "adverb_requests_total", route=route, http_method="POST", status="200") == 2


async def test_a_verb_without_measure_counts_poses_but_no_errors(client):
    await client.post("/v1/verbs/sway/sequence", json={"adverbs": SWAY, "fps": 10})
    found = await samples(client)
    assert value(found, "adverb_poses_total", verb="sway", method="rbf") > 5
    assert value(found, "adverb_pose_error_meters_count", verb="sway", version="1", method="rbf") == 0


async def test_the_quality_of_served_verbs_is_told(client, data_dir):
    found = await samples(client)
    assert value(found, "adverb_verb_version", verb="arm3") == 1
    assert 0 <= value(found, "adverb_verb_error_meters", verb="arm3", stat="mean") < 0.1
    assert value(found, "adverb_verb_files_skipped") == 2


async def test_names_that_clients_make_up_never_become_labels(client):
    for k in range(30):
        await client.get(f"/nope/{k}")
        await client.get(f"/v1/verbs/nope{k}")
        await client.post(f"/v1/verbs/nope{k}/pose", json={"adverbs": ARM})
        await client.post("/v1/verbs/arm3/pose", json={"adverbs": ARM, "method": f"made-up{k}"})
        await client.request(f"MADE{k}", "/livez")
    found = await samples(client)
    seen = {part for _, labels in found for _, part in labels}
    assert not [part for part in seen if "nope" in part or "made-up" in part or "MADE" in part]
    assert value(found, "adverb_requests_total", route="unmatched", http_method="GET", status="404") == 30
    assert value(found, "adverb_requests_total", route="/livez", http_method="other", status="405") == 30


def test_observing_many_equals_observing_each():
    values = np.concatenate([np.random.default_rng(0).lognormal(-3, 3, 500), [1e-3, 1.0, 0.0]])
    registry = CollectorRegistry()
    one, many = (Histogram(name, "x", buckets=(1e-3, 0.1, 1.0), registry=registry) for name in ("one", "many"))
    for each in values:
        one.observe(each)
    _observe_many(many, values)
    _observe_many(many, values[:0])
    for suffix, labels in [
        ("sum", {}),
        ("count", {}),
        *(("bucket", {"le": le}) for le in ("0.001", "0.1", "1.0", "+Inf")),
    ]:
        expected = registry.get_sample_value(f"one_{suffix}", labels)
        assert registry.get_sample_value(f"many_{suffix}", labels) == pytest.approx(expected)


def test_two_apps_count_apart():
    first, second = Metrics(), Metrics()
    first.count_request("/livez", "GET", 200)
    assert b"adverb_requests_total{" in first.text()
    assert b"adverb_requests_total{" not in second.text()


async def test_event_loop_lateness_is_watched(app):
    async with app.router.lifespan_context(app):
        metrics = app.state.server.metrics
        name = "adverb_event_loop_lateness_seconds_count"
        while metrics.registry.get_sample_value(name) == 0:  # noqa: ASYNC110 - metrics have no event
            await anyio.sleep(0.01)
