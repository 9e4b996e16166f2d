"""Alert rules: valid, about metrics that exist, fired by a synthetic series each, and in the runbook."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import httpx
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from service.metrics import Metrics
from tests.deploy.test_topology import until

PROJECT = Path(__file__).parents[2]
DEPLOY = PROJECT / "deploy"
RULES = [
    rule for group in yaml.safe_load((DEPLOY / "alerts.yml").read_text("utf-8"))["groups"] for rule in group["rules"]
]
NAMES = [rule["alert"] for rule in RULES]
SERIES = yaml.safe_load((DEPLOY / "alerts.test.yml").read_text("utf-8"))["tests"]


@pytest.fixture
def promtool():
    """A function that runs promtool and returns its result."""
    program = shutil.which("promtool")
    if program is None:
        pytest.skip("promtool is not here: install the Debian package prometheus")

    def run(*arguments, **options):
        return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False, **options)

    return run


def test_the_rules_are_valid(promtool):
    found = promtool("check", "rules", DEPLOY / "alerts.yml")
    assert found.returncode == 0, found.stdout + found.stderr
    assert f"{len(RULES)} rules found" in found.stdout


def test_prometheus_loads_the_rules(promtool, tmp_path):
    found = promtool("check", "config", DEPLOY / "prometheus.yml")
    assert found.returncode == 0, found.stdout + found.stderr
    compose = yaml.safe_load((PROJECT / "docker-compose.yml").read_text("utf-8"))
    mounted = compose["services"]["prometheus"]["volumes"]
    for name in yaml.safe_load((DEPLOY / "prometheus.yml").read_text("utf-8"))["rule_files"]:
        assert f"./deploy/{name}:/etc/prometheus/{name}:ro" in mounted


def test_each_alert_fires_and_is_quiet_when_all_is_well(promtool):
    found = promtool("test", "rules", DEPLOY / "alerts.test.yml")
    assert found.returncode == 0, found.stdout + found.stderr


def test_a_rule_that_does_not_fire_is_found(promtool, tmp_path):
    text = (DEPLOY / "alerts.yml").read_text("utf-8")
    assert text.count("> 0.025") == 1
    (tmp_path / "alerts.yml").write_text(text.replace("> 0.025", "> 0.5"), "utf-8")
    shutil.copy(DEPLOY / "alerts.test.yml", tmp_path)
    found = promtool("test", "rules", tmp_path / "alerts.test.yml")
    assert found.returncode != 0
    assert 'alertname=\\"StreamsLate\\"' in found.stdout + found.stderr


@pytest.mark.parametrize("name", NAMES)
def test_each_alert_has_a_series_before_and_after_it_fires(name):
    (row,) = [row for row in SERIES if row["name"] == name]
    before, after = row["promql_expr_test"]
    for query in (before, after):
        assert query["expr"] == f'count(ALERTS{{alertname="{name}", alertstate="firing"}})'
    assert before["exp_samples"] == []
    assert after["exp_samples"] == [{"value": 1}]


@pytest.mark.parametrize("rule", RULES, ids=NAMES)
def test_what_a_rule_names_exists(rule):
    metrics = Metrics()
    metrics.set_database(True)  # absent on a server without a database
    families = list(text_string_to_metric_families(metrics.text().decode()))
    endings = {"counter": ["_total"], "histogram": ["_bucket", "_sum", "_count"], "gauge": [""]}
    known = {family.name + ending for family in families for ending in endings.get(family.type, [""])} | {"up"}
    named = set(re.findall(r"\b(?:adverb_\w+|process_\w+|up)\b", rule["expr"]))
    assert named
    assert named <= known


def test_each_alert_has_its_line_in_the_runbook_and_each_line_its_alert():
    section = (
        (PROJECT / "docs" / "operations.md").read_text("utf-8").partition("\n## Alerts\n")[2].partition("\n## ")[0]
    )
    rows = [re.split(r" *(?<!\\)\| *", line)[1:-1] for line in section.splitlines() if line.startswith("| `")]
    assert [row[0].strip("`") for row in rows] == NAMES
    for name, *cells in rows:
        assert len(cells) == 3, name
        assert all(cells), name


@pytest.mark.slow
def test_metrics_of_a_server_are_well_formed(promtool, warm, tmp_path):
    log = tmp_path / "log"
    environment = {**os.environ, "ADVERB_REFINERS": "0"}
    with log.open("wb") as stderr:
        process = warm.start("serve", "--port", "0", environment=environment, stderr=stderr)
    try:
        until(lambda: "Adverb is ready on " in log.read_text())
        base = log.read_text().partition("Adverb is ready on ")[2].partition(" ")[0]
        assert httpx.get(f"{base}/v1/verbs").status_code == 200
        text = httpx.get(f"{base}/metrics").text
    finally:
        process.end()
    assert "adverb_requests_total" in text
    found = promtool("check", "metrics", input=text)
    assert found.returncode == 0, found.stdout + found.stderr
