"""docker-compose.yml and the Dockerfile: valid, hardened, and true to the files and settings that they name.

No container is started here; what is inside them is started by test_topology.py.
"""

import json
import re
from pathlib import Path

import compose_spec
import pytest
import yaml

from service.settings import Settings

PROJECT = Path(__file__).parents[2]
SECRETS = {"POSTGRES_PASSWORD", "GRAFANA_PASSWORD"}
TEXT = (PROJECT / "docker-compose.yml").read_text(encoding="utf-8")


def interpolated(text: str, given: dict[str, str]) -> str:
    """What Compose makes of ``${NAME:-default}`` and ``${NAME:?problem}``; the latter have to be given."""
    found = re.sub(r"\$\{(\w+):-([^}]*)\}", lambda match: given.get(match[1], match[2]), text)
    return re.sub(r"\$\{(\w+):\?[^}]+\}", lambda match: given[match[1]], found)


@pytest.fixture(scope="module")
def compose() -> dict:
    return yaml.safe_load(interpolated(TEXT, dict.fromkeys(SECRETS, "secret")))


def services() -> list[str]:
    return list(yaml.safe_load(TEXT)["services"])


def test_it_follows_the_compose_specification(compose):
    assert compose_spec.PyCompose.from_yaml(json.dumps(compose))


def test_the_check_finds_what_is_wrong(compose):
    wrong = json.loads(json.dumps(compose))
    wrong["services"]["worker"]["depends_on"]["server"]["condition"] = "service_heathy"
    with pytest.raises(ValueError, match="service_heathy"):
        compose_spec.PyCompose.from_yaml(json.dumps(wrong))


def test_nothing_is_left_to_interpolate(compose):
    assert "${" not in json.dumps(compose)


def test_secrets_have_to_be_set_and_are_in_the_example():
    requested = set(re.findall(r"\$\{(\w+):\?", TEXT))
    assert requested == SECRETS
    example = (PROJECT / "deploy" / "env.example").read_text(encoding="utf-8")
    assert {name for name in SECRETS if f"\n{name}=\n" in example} == SECRETS
    optional = set(re.findall(r"\$\{(\w+):-", TEXT))
    assert set(re.findall(r"^#(\w+)=", example, re.MULTILINE)) == optional
    for name, default in re.findall(r"\$\{(\w+):-([^}]*)\}", TEXT):
        assert f"#{name}={default}\n" in example


@pytest.mark.parametrize("name", services())
def test_each_service_is_hardened_and_watched(compose, name):
    service = compose["services"][name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert "privileged" not in service
    assert re.fullmatch(r"[\w./-]+:v?\d[\w.-]*", service["image"])
    assert "healthcheck" in service or ("build" in service and "HEALTHCHECK" in dockerfile())
    for port in service.get("ports", []):
        assert port.startswith("127.0.0.1:")


def test_only_the_proxy_and_grafana_can_be_reached(compose):
    assert compose["networks"]["inside"]["internal"] is True
    outside = {name for name, row in compose["services"].items() if "outside" in row["networks"] or "ports" in row}
    assert outside == {"proxy", "grafana"}


@pytest.mark.parametrize("name", services())
def test_what_a_service_refers_to_is_there(compose, name):
    service = compose["services"][name]
    assert set(service["networks"]) <= set(compose["networks"])
    for volume in service.get("volumes", []):
        source, _, mode = volume.split(":", 1)[0], *volume.split(":", 1)[1].partition(":")[::2]
        if source.startswith("."):
            assert (PROJECT / source).exists(), source
            assert mode == "ro"
        else:
            assert source in compose["volumes"], source
    for other, how in service.get("depends_on", {}).items():
        assert how["condition"] == "service_healthy"
        assert other in compose["services"]


@pytest.mark.parametrize("name", ["server", "worker"])
def test_settings_of_servers_and_workers_exist_and_are_right(compose, name, monkeypatch):
    environment = compose["services"][name]["environment"]
    for key, value in environment.items():
        if key == "FORWARDED_ALLOW_IPS":  # of uvicorn
            continue
        assert key.startswith("ADVERB_")
        assert key.removeprefix("ADVERB_").lower() in Settings.model_fields
        monkeypatch.setenv(key, value)
    settings = Settings()
    user, password = "adverb", "secret"
    assert settings.database_url == f"postgresql://{user}:{password}@postgres/adverb"
    assert compose["services"]["postgres"]["environment"] == {
        "POSTGRES_DB": "adverb",
        "POSTGRES_USER": user,
        "POSTGRES_PASSWORD": password,
    }
    assert f"{settings.artifact_url}" in [volume.partition(":")[2] for volume in compose["services"][name]["volumes"]]


def dockerfile() -> str:
    return (PROJECT / "Dockerfile").read_text(encoding="utf-8")


def test_the_image_s_settings_exist():
    names = set(re.findall(r"\bADVERB_(\w+)=", dockerfile()))
    assert names
    assert {name.lower() for name in names} <= set(Settings.model_fields)


def test_the_image_is_built_of_files_that_are_there_and_carried():
    ignored = (PROJECT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    carried = [Path(line[1:]) for line in ignored if line.startswith("!")]
    for line in re.findall(r"^COPY (?!--from)(.*)$", dockerfile(), re.MULTILINE):
        *sources, _ = line.split()
        for source in sources:
            assert (PROJECT / source).exists(), source
            assert any(Path(source).is_relative_to(path) for path in carried), source


def test_the_image_runs_as_nobody_in_particular_and_ends_when_asked_to():
    stage = dockerfile().rpartition("\nFROM ")[2]
    assert "\nUSER 10001:10001\n" in stage
    assert "\nSTOPSIGNAL SIGTERM\n" in stage
    for command in ("CMD", "ENTRYPOINT"):
        assert json.loads(re.search(rf"^{command} (\[.*\])$", stage, re.MULTILINE)[1])
    assert re.search(r"^ +CMD (\[.*/readyz.*\])$", stage, re.MULTILINE)
    assert "--require-hashes -r /src/requirements.runtime.lock" in dockerfile()


def test_the_start_script_is_a_program():
    start = PROJECT / "deploy" / "start"
    assert start.stat().st_mode & 0o111 == 0o111
    assert 'exec "$@"' in start.read_text(encoding="utf-8")


def test_nginx_sends_requests_and_streams_to_the_servers(compose):
    text = (PROJECT / "deploy" / "nginx.conf").read_text(encoding="utf-8")
    host, port = re.search(r"^ +server (\w+):(\d+) resolve", text, re.MULTILINE).groups()
    assert host in compose["services"]
    assert f"ADVERB_PORT={port}" in dockerfile()
    listening = re.search(r"^ +listen (\d+)", text, re.MULTILINE)[1]
    assert compose["services"]["proxy"]["ports"] == [f"127.0.0.1:8000:{listening}"]
    for line in ("proxy_http_version 1.1;", "proxy_set_header Upgrade $http_upgrade;", "proxy_buffering off;"):
        assert line in text
    assert text.count("{") == text.count("}")
    largest = int(re.search(r"client_max_body_size (\d+)m;", text)[1]) * 1024 * 1024
    assert largest == Settings().max_upload_bytes
