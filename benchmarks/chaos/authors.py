"""Authors: each follows its part of the plan, and the ledger has what was acknowledged."""

from __future__ import annotations

import asyncio
import hashlib
import io
import random
import re
import zipfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx

from benchmarks.chaos.ledger import Ledger
from benchmarks.chaos.plan import OWN, Operation, Plan
from benchmarks.chaos.requests import response_problem
from verbs import library
from verbs.io import artifact

__all__ = ["Author", "Uploads"]

TIMEOUT_S = 90.0
"""Longest wait for an answer, seconds; an upload is built in at most 120 s of computing time, here in one or two."""
AGAIN_S = 1.0
OCTETS, ZIP = {"Content-Type": "application/octet-stream"}, {"Content-Type": "application/zip"}


class Uploads:
    """Bytes of uploads: copies of built-in verbs and sources with a name and description of their own."""

    def __init__(self, plan: Plan) -> None:
        self._verbs = {
            name: artifact.load(_builtin(f"{name}.verb")) for name in {_model(row.verb) for row in plan.operations}
        }

    def verb(self, name: str, text: str) -> bytes:
        """An artifact."""
        with TemporaryDirectory(prefix="chaos-upload-") as folder:
            path = Path(folder) / "upload.verb"
            artifact.save(replace(self._verbs[_model(name)], name=name, description=text), path)
            return path.read_bytes()

    def source(self, name: str, text: str) -> bytes:
        """A zip of a source."""
        packed, folder = io.BytesIO(), _builtin(_model(name))
        with zipfile.ZipFile(packed, "w") as archive:
            for path in sorted(folder.iterdir()):
                content = path.read_bytes()
                if path.name == "verb.toml":
                    content = _with(_with(content.decode(), "name", name), "description", text).encode()
                archive.writestr(path.name, content)
        return packed.getvalue()


def _with(toml: str, field: str, text: str) -> str:
    """A verb.toml with another text in its first line with a field."""
    return re.sub(rf'^{field} = ".*"$', f'{field} = "{text}"', toml, count=1, flags=re.MULTILINE)


def _model(name: str) -> str:
    """The built-in verb that an author's verb is a copy of."""
    return "arm3" if name in OWN else name


def _builtin(name: str) -> Path:
    return Path(library.__file__).parent / name


class Author:
    """One author; only it changes its own verbs, beside refinements that it has started.

    Parameters
    ----------
    number : int
    base : str
    plan : Plan
    uploads : Uploads
    ledger : Ledger
    """

    def __init__(self, number: int, base: str, plan: Plan, uploads: Uploads, ledger: Ledger) -> None:
        self.number, self.uploads, self.ledger = number, uploads, ledger
        self.operations = [row for row in plan.operations if row.author == number]
        self._base, self._count = base, 0
        self._verb = ""
        self._port: object = None
        self._began_s = 0.0  # when the last request was sent

    async def run(self, stop: asyncio.Event) -> None:
        """Do what the plan has, one operation after the other; what failed is not repeated."""
        for operation in self.operations:
            await asyncio.sleep(max(operation.at_s - self.ledger.now_s(), 0.0))
            if stop.is_set():
                return
            limits = httpx.Limits(max_connections=1)
            async with httpx.AsyncClient(base_url=self._base, timeout=TIMEOUT_S, limits=limits) as http:
                await self._do(http, operation)

    async def _do(self, http: httpx.AsyncClient, operation: Operation) -> None:
        verb, kind = operation.verb, operation.kind
        if kind == "upload verb":
            await self._upload(http, verb, kind, OCTETS)
        elif kind == "upload source":
            await self._upload(http, verb, kind, ZIP)
        elif kind == "refine":
            await self._refine(http, operation)
        elif kind == "delete":
            await self._delete(http, verb)
        else:
            await self._activate(http, operation)

    async def _send(self, http: httpx.AsyncClient, what: str, method: str, path: str, **options: Any) -> Any:
        """A response with a status below 300, or None, with the problem in the ledger."""
        began_s = self._began_s = self.ledger.now_s()
        try:
            response = await http.request(method, path, **options)
        except httpx.HTTPError as err:
            self.ledger.failed(began_s, what, type(err).__name__)
            return None
        if response.status_code >= 300:
            self.ledger.failed(began_s, what, response_problem(response))
            return None
        self.ledger.done[what.split(" of ", maxsplit=1)[0]] += 1
        self._port = None
        with suppress(ValueError):  # the server has closed the connection meanwhile
            self._port = response.extensions["network_stream"].get_extra_info("client_addr")
        return response

    async def _upload(self, http: httpx.AsyncClient, verb: str, kind: str, headers: dict[str, str]) -> None:
        self._count += 1
        text = f"author {self.number}, upload {self._count}"
        make = self.uploads.source if kind == "upload source" else self.uploads.verb
        content = await asyncio.to_thread(make, verb, text)
        response = await self._send(http, f"{kind} of {verb}", "POST", "/v1/verbs", content=content, headers=headers)
        changes = self.ledger.of(verb)
        if response is None:
            changes.unsure.append((self.ledger.now_s(), None, True))
            return
        found = response.json()
        if kind == "upload verb" and found["sha256"] != hashlib.sha256(content).hexdigest():
            self.ledger.fault(f"{verb} {found['version']} has another hash than its upload")
        self.ledger.versions[verb, found["version"]] = found["sha256"]
        changes.acknowledged(self._began_s, self.ledger.now_s(), found["version"])

    async def _activate(self, http: httpx.AsyncClient, operation: Operation) -> None:
        """Activate an older version, or the newest one."""
        verb, kind = operation.verb, operation.kind
        numbers = sorted(number for name, number in self.ledger.versions if name == verb)
        if not numbers:
            return
        number = numbers[-1] if kind == "roll forward" else numbers[operation.pick % len(numbers)]
        response = await self._send(http, f"{kind} of {verb}", "POST", f"/v1/verbs/{verb}/versions/{number}/activate")
        changes = self.ledger.of(verb)
        if response is None:
            changes.unsure.append((self.ledger.now_s(), number, False))
        else:
            changes.acknowledged(self._began_s, self.ledger.now_s(), number)

    async def _delete(self, http: httpx.AsyncClient, verb: str) -> None:
        """Delete a verb; the server that answered does not list it any more."""
        changes = self.ledger.of(verb)
        if not changes.possible or (changes.possible == {None} and not changes.unsure):
            return
        unsure = bool(changes.unsure) or len(changes.possible) > 1
        response = await self._send(http, f"delete of {verb}", "DELETE", f"/v1/verbs/{verb}")
        if response is None:
            if unsure and self.ledger.answers[-1].problem == "404 unknown_verb":
                self.ledger.answers.pop()  # an earlier deletion, whose answer was lost, has happened
                changes.acknowledged(self._began_s, self.ledger.now_s(), None)
                return
            changes.unsure.append((self.ledger.now_s(), None, False))
            return
        changes.acknowledged(self._began_s, self.ledger.now_s(), None)
        port, listed = self._port, await self._send(http, "list after a deletion", "GET", "/v1/verbs")
        same = listed is not None and port is not None and port == self._port
        if same and not changes.unsure and verb in {row["name"] for row in listed.json()["verbs"]}:
            self.ledger.fault(f"{verb} is listed after its deletion, on the same connection")

    async def _refine(self, http: httpx.AsyncClient, operation: Operation) -> None:
        """Start a small refinement."""
        rng, verb = random.Random(operation.pick), operation.verb
        body: dict[str, Any] = {"budget_s": rng.choice((4, 8)), "seed": rng.randrange(1000)}
        if rng.random() < 0.5:
            body |= {"for": "error", "max_pseudo": rng.choice((2, 4)), "target_error": 1e-4}
        else:
            body |= {"for": "quality", "max_pseudo": 1}
        changes = self.ledger.of(verb)
        response = await self._send(http, f"refine of {verb}", "POST", f"/v1/verbs/{verb}/refinements", json=body)
        if response is None:
            problem = self.ledger.answers[-1].problem
            gone = None in changes.possible or bool(changes.unsure)
            if problem == "409 already_refining" or (problem == "404 unknown_verb" and gone):
                self.ledger.answers.pop()
                self.ledger.done[problem] += 1
            return
        self.ledger.jobs[response.json()["id"]] = verb
