"""What the trial of the image makes of docker-compose.yml. The trial itself is `make try-image`."""

from pathlib import Path

import pytest
import yaml

from deploy.try_image import compose
from deploy.try_image.images import BASES, SUITES

PROJECT = Path(__file__).parents[2]
FILE = PROJECT / "docker-compose.yml"
GIVEN = {"POSTGRES_PASSWORD": "secret", "GRAFANA_PASSWORD": "unused", "SERVERS": "3"}


@pytest.fixture(scope="module")
def services():
    return compose.read(FILE, GIVEN)[0]


def edited(tmp_path, change):
    """docker-compose.yml with a change, in a folder of its own."""
    document = yaml.safe_load(compose.interpolated(FILE.read_text("utf-8"), GIVEN))
    change(document["services"])
    path = tmp_path / "docker-compose.yml"
    path.write_text(yaml.safe_dump(document), "utf-8")
    return path


def test_every_service_is_read_after_those_that_it_needs(services):
    assert set(services) == set(yaml.safe_load(FILE.read_text("utf-8"))["services"])
    order = list(services)
    for name, service in services.items():
        assert all(order.index(other) < order.index(name) for other in service.needs)


def test_a_server_gets_what_compose_says(services):
    arguments = services["server"].arguments()
    for expected in (
        "--read-only",
        "--cap-drop=ALL",
        "--security-opt=no-new-privileges",
        "--init",
        "--stop-timeout=20",
        "--env=ADVERB_DATABASE_URL=postgresql://adverb:secret@postgres/adverb",
        "--volume=verbs:/verbs",
        "--tmpfs=/data:rw,noexec,nosuid,nodev,notmpcopyup,size=1g",
    ):
        assert expected in arguments
    assert services["server"].replicas == 3
    assert services["worker"].command() == ["adverb", "worker"]
    assert services["server"].check is None  # the image has it


def test_files_of_the_project_are_mounted_from_it(services):
    assert f"--volume={PROJECT}/deploy/nginx.conf:/etc/nginx/nginx.conf:ro" in services["proxy"].arguments()


def test_a_key_that_would_not_be_tried_is_refused(tmp_path):
    path = edited(tmp_path, lambda rows: rows["server"].update(privileged=True))
    with pytest.raises(ValueError, match="server: privileged"):
        compose.read(path, GIVEN)


def test_a_circle_of_dependencies_is_refused(tmp_path):
    path = edited(
        tmp_path, lambda rows: rows["postgres"].update(depends_on={"server": {"condition": "service_healthy"}})
    )
    with pytest.raises(ValueError, match="circle"):
        compose.read(path, GIVEN)


def test_a_password_that_is_not_given_is_an_error():
    with pytest.raises(KeyError, match="POSTGRES_PASSWORD"):
        compose.read(FILE, {})


def test_stand_ins_exist_and_name_no_address():
    for name in SUITES:
        assert (BASES / f"{name.rpartition('/')[2]}.Containerfile").exists()
    for path in (PROJECT / "deploy" / "try_image").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            assert "https://" not in path.read_text("utf-8"), path


def test_the_folder_of_uploads_is_open_to_the_user_of_the_image():
    """A tmpfs belongs to root and has the mode of the folder that it covers."""
    stage = (PROJECT / "Dockerfile").read_text("utf-8").rpartition("\nFROM ")[2]
    assert "install -d -m 1777 /data" in stage
