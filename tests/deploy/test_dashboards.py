"""Prometheus' and Grafana's files: what they ask for exists."""

import json
import re
from pathlib import Path

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from service.metrics import Metrics

DEPLOY = Path(__file__).parents[2] / "deploy"
DASHBOARD = json.loads((DEPLOY / "grafana" / "dashboards" / "adverb.json").read_text(encoding="utf-8"))
QUERIES = [(panel["title"], target["expr"]) for panel in DASHBOARD["panels"] for target in panel["targets"]]

ENDINGS = {"counter": {"_total"}, "histogram": {"_bucket", "_sum", "_count"}, "gauge": {""}}
ENDS = ("", "_total", "_bucket", "_sum", "_count")


def read(path: str) -> dict:
    return yaml.safe_load((DEPLOY / path).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def kinds() -> dict[str, str]:
    """Type of every metric of a server, by its name without what the type appends."""
    metrics = Metrics()
    metrics.set_database(True)  # absent on a server without a database
    families = text_string_to_metric_families(metrics.text().decode())
    return {family.name: family.type for family in families}


@pytest.fixture(scope="module")
def labels() -> set[str]:
    """Every label of a metric, and those that Prometheus and histograms add."""
    metrics = Metrics()
    found = [*vars(metrics).values(), *metrics.registry.collect()]
    return {label for one in found for label in getattr(one, "_labelnames", ())} | {"le", "instance"}


@pytest.mark.parametrize(("title", "query"), QUERIES)
def test_what_a_panel_asks_for_exists(kinds, labels, title, query):
    names = re.findall(r"\b(?:adverb|process)_\w+", query)
    assert names, title
    for name in names:
        base = next((name.removesuffix(end) for end in ENDS if name.removesuffix(end) in kinds), None)
        assert base, f"{title}: there is no {name}"
        assert name.removeprefix(base) in ENDINGS[kinds[base]], name
    for group in [*re.findall(r"by \(([^)]*)\)", query), *re.findall(r"\{(\w+)[!=]", query)]:
        assert set(group.split(", ")) <= labels, f"{title}: {group}"


def test_each_metric_is_shown(kinds):
    """Each metric is on the dashboard, or listed here as an exception."""
    shown = " ".join(query for _, query in QUERIES)
    own = {name for name in kinds if name.startswith("adverb_")}
    assert {name for name in own if name not in shown} == {"adverb_verb_files_skipped"}  # reported by /readyz


def test_the_dashboard_is_provisioned():
    compose = yaml.safe_load((DEPLOY.parent / "docker-compose.yml").read_text(encoding="utf-8"))
    mounted = [volume.split(":")[1] for volume in compose["services"]["grafana"]["volumes"]]
    (provider,) = read("grafana/provisioning/dashboards/adverb.yml")["providers"]
    assert provider["options"]["path"] in mounted
    home = compose["services"]["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"]
    assert home == f"{provider['options']['path']}/adverb.json"
    (source,) = read("grafana/provisioning/datasources/prometheus.yml")["datasources"]
    assert source["isDefault"] is True
    assert source["url"].removeprefix("http://").split(":")[0] in compose["services"]


def test_panels_do_not_overlap():
    taken = set()
    for panel in DASHBOARD["panels"]:
        at = panel["gridPos"]
        cells = {(at["x"] + x, at["y"] + y) for x in range(at["w"]) for y in range(at["h"])}
        assert not cells & taken
        assert at["x"] + at["w"] <= 24
        taken |= cells


def test_prometheus_asks_every_server():
    (job,) = read("prometheus.yml")["scrape_configs"]
    (found,) = job["dns_sd_configs"]
    compose = yaml.safe_load((DEPLOY.parent / "docker-compose.yml").read_text(encoding="utf-8"))
    (server,) = found["names"]
    assert set(compose["services"][server]["networks"]) & set(compose["services"]["prometheus"]["networks"])
    assert f"ADVERB_PORT={found['port']}" in (DEPLOY.parent / "Dockerfile").read_text(encoding="utf-8")
