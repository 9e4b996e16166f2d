"""Every route of the server has a call in both clients, and every call works on a real server."""

import inspect
import json
import re
import zipfile
from io import BytesIO
from pathlib import Path

import httpx
import numpy as np
import pytest
from adverb_client import AsyncClient, Client, ResponseError, errors

DOCUMENT = json.loads((Path(__file__).resolve().parents[3] / "docs" / "openapi.json").read_text())
ROUTES = {(method.upper(), path) for path, row in DOCUMENT["paths"].items() for method in row}
ALIASES = {("GET", "/v2/health/live"), ("GET", "/v2/health/ready")}
"""Of /livez and /readyz, for other protocols."""

AT = {"x": 0.4, "y": 0.3}
CALLS = {
    "access": (), "activate": ("arm", 2), "add_example": ("arm", b"x"), "artifact": ("arm",), "bvh": ("arm", AT),
    "cancel_refinement": ("r",), "change_draft": ("d",), "changes": (), "create_draft": (b"PK",), "delete": ("arm",),
    "delete_draft": ("d",), "download": ("arm", 1), "draft": ("d",),
    "draft_motion": ("d",), "draft_pose": ("d", AT), "draft_sequence": ("d", AT), "drafts": (),
    "export": ("arm", "npz", AT), "follow_refinement": ("r",), "health": (), "live": (), "metrics": (),
    "pose": ("arm", AT), "poses": ("arm", [[0.1, 0.2]]), "publish_draft": ("d",), "quality": ("arm",),
    "refine": ("arm",), "refinement": ("r",), "refinements": (), "sequence": ("arm", AT), "upload": (b"x",),
    "verb": ("arm",), "verbs": (), "versions": ("arm",),
}  # fmt: skip
"""Arguments of every call."""
OTHERS = {"close", "wait_ready", "wait_refinement"}
"""Methods that repeat other calls, or send nothing."""


def public(kind):
    return {name for name, _ in inspect.getmembers(kind, inspect.isfunction) if not name.startswith("_")}


def template_of(method, path):
    """The route of a request."""
    found = [
        (verb, route)
        for verb, route in ROUTES
        if verb == method and re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", route), path)
    ]
    assert len(found) == 1, (method, path, found)
    return found[0]


class Recorder:
    """A transport that refuses every request and notes its route."""

    def __init__(self):
        self.routes = set()

    def __call__(self, request):
        self.routes.add(template_of(request.method, request.url.path))
        return httpx.Response(500, json={"code": "internal_error", "detail": "refused"})


def arguments_of(name):
    return {"file": "clip.bvh"} if name == "add_example" else {}


def test_every_route_has_a_call():
    recorder = Recorder()
    with Client(transport=httpx.MockTransport(recorder)) as client:
        for name, arguments in CALLS.items():
            with pytest.raises(ResponseError):
                list(getattr(client, name)(*arguments, **arguments_of(name)))  # one is an iterator
    assert ROUTES - recorder.routes == ALIASES


@pytest.mark.anyio
async def test_every_route_has_an_asynchronous_call():
    recorder = Recorder()
    async with AsyncClient(transport=httpx.MockTransport(recorder)) as client:
        for name, arguments in CALLS.items():
            found = getattr(client, name)(*arguments, **arguments_of(name))
            with pytest.raises(ResponseError):
                await (anext(found) if inspect.isasyncgen(found) else found)
    assert ROUTES - recorder.routes == ALIASES


def test_no_call_is_missing_here():
    assert public(Client) == public(AsyncClient) == CALLS.keys() | OTHERS


def test_both_clients_have_the_same_parameters():
    for name in CALLS:
        blocking, other = (inspect.signature(getattr(kind, name)).parameters for kind in (Client, AsyncClient))
        assert list(blocking.values()) == list(other.values()), name


def test_files_of_a_motion(address):
    goal = {"x": -0.3, "y": 1.2, "z": 0.4}
    starts = {"bvh": b"HIERARCHY", "glb": b"glTF", "vrma": b"glTF", "npz": b"PK"}
    with Client(address) as client:
        found = {form: client.export("reach", form, goal, fps=20) for form in starts}
        for form, start in starts.items():
            assert found[form].startswith(start), form
        assert found["bvh"].decode() == client.bvh("reach", goal, fps=20)
        assert len(client.export("reach", "glb", goal, fps=20, mannequin=True)) > len(found["glb"])
        names = zipfile.ZipFile(BytesIO(found["npz"])).namelist()
        assert all(name.endswith(".npy") for name in names)
        with pytest.raises(ValueError, match="expected one of bvh, glb, vrma, npz"):
            client.export("reach", "fbx", goal)
        with pytest.raises(errors.BadRequest):
            client.export("arm3", "vrma", AT)  # no humanoid


def test_maps_metrics_and_artifacts(address):
    with Client(address) as client:
        found = client.quality("reach", across="x", up="y", at={"z": 0.4}, nodes=5)
        assert (found.verb, found.across, found.up, found.held) == ("reach", "x", "y", {"z": 0.4})
        assert found.error.shape == found.smoothness.shape == found.support.shape == (5, 5)
        assert 0.0 <= np.nanmax(found.error) < 1e-6
        assert found.columns.shape == found.rows.shape == (5,)
        with pytest.raises(errors.BadRequest):
            client.quality("reach", nodes=2)
        assert client.live() is True
        assert "# TYPE adverb_request_duration_seconds histogram" in client.metrics()
        assert len(client.artifact("arm3")) > 1_000
