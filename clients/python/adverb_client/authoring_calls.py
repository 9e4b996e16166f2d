"""Calls of both REST clients that change verbs; the operations are in ``authoring_api``."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, TypeVar

from adverb_client.api import Operation
from adverb_client.authoring_api import AuthoringApi
from adverb_client.authoring_models import Access, Change, Draft, DraftSummary, Refinement, Version
from adverb_client.errors import TimedOut

__all__ = ["AsyncAuthoringCalls", "AuthoringCalls"]

T = TypeVar("T")

FOLLOW_S = 0.5
"""Interval between two reads a refinement."""


def _named(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options by the names of the request; ``for`` is a keyword of Python."""
    return {"for" if name == "aim" else name: value for name, value in options.items()}


def _late(job: Refinement, timeout_s: float) -> TimedOut:
    return TimedOut(f"refinement {job.id} is {job.state} after {timeout_s:g} s")


class AuthoringCalls(ABC):
    """Versions, refinements, drafts and the list of changes."""

    _authoring: AuthoringApi
    _sleep: Callable[[float], None]

    @abstractmethod
    def _run(self, operation: Operation[T]) -> T:
        """Send the requests of an operation; the clients do."""

    def versions(self, verb: str) -> tuple[Version, ...]:
        """The versions of a verb, the newest first."""
        return self._run(self._authoring.versions(verb))

    def upload(self, content: bytes, *, expected: int | None = None) -> Version:
        """Publish a verb file, or a zip of a verb source, which the server builds first.

        Parameters
        ----------
        content : bytes
        expected : int, optional
            Publish only if this version is current; 0 for a new verb.

        Raises
        ------
        BadUpload
            It is not a verb; the detail names the problem.
        VersionConflict
            Another version is current than expected.
        ResponseError, TransportError, DecodeError
            Nothing is sent twice: after :class:`StoreUnavailable` the version may have been published.
        """
        return self._run(self._authoring.upload(content, expected))

    def add_example(
        self,
        verb: str,
        content: bytes,
        *,
        file: str,
        keytimes: Sequence[float] | None = None,
        style: Mapping[str, float] | None = None,
        expected: int | None = None,
    ) -> Version:
        """Publish a version with one more example.

        Parameters
        ----------
        verb : str
        content : bytes
            A motion file.
        file : str
            Its name with the ending, .bvh, .glb or .npz.
        keytimes : sequence of float, optional
            Seconds of the file; proposed by the server where omitted.
        style : mapping, optional
            Values of style adverbs.
        expected : int, optional
            Publish only if this version is current.
        """
        return self._run(self._authoring.add_example(verb, content, file, keytimes, style or {}, expected))

    def activate(self, verb: str, number: int, *, expected: int | None = None) -> Version:
        """Serve another version; streams change to it between two frames."""
        return self._run(self._authoring.activate(verb, number, expected))

    def delete(self, verb: str, *, expected: int | None = None) -> None:
        """Stop serving a verb. Its versions are kept for a while; activating one serves it again."""
        self._run(self._authoring.delete(verb, expected))

    def download(self, verb: str, number: int) -> bytes:
        """The verb file of a version."""
        return self._run(self._authoring.download(verb, number))

    def refine(self, verb: str, **options: Any) -> Refinement:
        """Start a refinement; a worker of the server does it.

        Parameters
        ----------
        verb : str
        **options
            Fields of the request in docs/rest.md, such as ``max_pseudo`` or ``budget_s``; ``aim`` is its field ``for``.
        """
        return self._run(self._authoring.refine(verb, _named(options)))

    def refinement(self, id: str) -> Refinement:
        """One refinement."""
        return self._run(self._authoring.refinement(id))

    def refinements(self, verb: str | None = None, *, limit: int = 100) -> tuple[Refinement, ...]:
        """The newest refinements, of one verb or of all."""
        return self._run(self._authoring.refinements(verb, limit))

    def cancel_refinement(self, id: str) -> Refinement:
        """Stop a refinement after its current step. One that has ended is returned unchanged."""
        return self._run(self._authoring.cancel_refinement(id))

    def wait_refinement(
        self, id: str, *, timeout_s: float = 600.0, progress: Callable[[Refinement], object] | None = None
    ) -> Refinement:
        """Wait until a refinement has ended.

        Parameters
        ----------
        id : str
        timeout_s : float
        progress : callable, optional
            Called with the refinement after each look at it, twice a second.

        Raises
        ------
        TimedOut
            It has not ended in time; it continues.
        """
        end = time.monotonic() + timeout_s
        while True:
            job = self.refinement(id)
            if progress is not None:
                progress(job)
            if job.ended:
                return job
            if time.monotonic() > end:
                raise _late(job, timeout_s)
            self._sleep(FOLLOW_S)

    def create_draft(self, content: bytes, **options: Any) -> Draft:
        """Make a draft of a zip of motion files: keytimes, adverbs, unit and axes are proposed.

        Parameters
        ----------
        content : bytes
        **options
            ``name``, ``effector``, ``measure``, ``unit``, ``pattern``; ``keytime_names``, a sequence; ``annotated``, a
            mapping from files to their keytimes in seconds.
        """
        return self._run(self._authoring.create_draft(content, options))

    def drafts(self) -> tuple[DraftSummary, ...]:
        """The drafts, the last changed first."""
        return self._run(self._authoring.drafts())

    def draft(self, id: str) -> Draft:
        """One draft."""
        return self._run(self._authoring.draft(id))

    def change_draft(self, id: str, *, revision: int | None = None, **changes: Any) -> Draft:
        """Change a draft.

        Parameters
        ----------
        id : str
        revision : int, optional
            Change only this revision.
        **changes
            Fields of ``PATCH`` in docs/rest.md, such as ``name``, ``clips`` or ``propose``.
        """
        return self._run(self._authoring.change_draft(id, changes, revision))

    def publish_draft(self, id: str, *, name: str | None = None, revision: int | None = None) -> Version:
        """Publish the verb of a draft, under its name or another."""
        return self._run(self._authoring.publish_draft(id, name, revision))

    def delete_draft(self, id: str) -> None:
        """Remove a draft."""
        self._run(self._authoring.delete_draft(id))

    def changes(
        self, verb: str | None = None, *, author: str | None = None, before: int | None = None, limit: int = 100
    ) -> tuple[Change, ...]:
        """Publications, activations, deletions and refinements with their authors, the newest first.

        Parameters
        ----------
        verb, author : str, optional
            Only those of this verb, of this author.
        before : int, optional
            Only those before the one with this id: the next page.
        limit : int
        """
        return self._run(self._authoring.changes(verb, author, before, limit))

    def access(self) -> Access:
        """The key of this client and its scopes."""
        return self._run(self._authoring.access())


class AsyncAuthoringCalls(ABC):
    """As :class:`AuthoringCalls`, asynchronously."""

    _authoring: AuthoringApi
    _sleep: Callable[[float], Awaitable[None]]

    @abstractmethod
    async def _run(self, operation: Operation[T]) -> T:
        """Send the requests of an operation; the clients do."""

    async def versions(self, verb: str) -> tuple[Version, ...]:
        """As :meth:`AuthoringCalls.versions`."""
        return await self._run(self._authoring.versions(verb))

    async def upload(self, content: bytes, *, expected: int | None = None) -> Version:
        """As :meth:`AuthoringCalls.upload`."""
        return await self._run(self._authoring.upload(content, expected))

    async def add_example(
        self,
        verb: str,
        content: bytes,
        *,
        file: str,
        keytimes: Sequence[float] | None = None,
        style: Mapping[str, float] | None = None,
        expected: int | None = None,
    ) -> Version:
        """As :meth:`AuthoringCalls.add_example`."""
        return await self._run(self._authoring.add_example(verb, content, file, keytimes, style or {}, expected))

    async def activate(self, verb: str, number: int, *, expected: int | None = None) -> Version:
        """As :meth:`AuthoringCalls.activate`."""
        return await self._run(self._authoring.activate(verb, number, expected))

    async def delete(self, verb: str, *, expected: int | None = None) -> None:
        """As :meth:`AuthoringCalls.delete`."""
        await self._run(self._authoring.delete(verb, expected))

    async def download(self, verb: str, number: int) -> bytes:
        """As :meth:`AuthoringCalls.download`."""
        return await self._run(self._authoring.download(verb, number))

    async def refine(self, verb: str, **options: Any) -> Refinement:
        """As :meth:`AuthoringCalls.refine`."""
        return await self._run(self._authoring.refine(verb, _named(options)))

    async def refinement(self, id: str) -> Refinement:
        """As :meth:`AuthoringCalls.refinement`."""
        return await self._run(self._authoring.refinement(id))

    async def refinements(self, verb: str | None = None, *, limit: int = 100) -> tuple[Refinement, ...]:
        """As :meth:`AuthoringCalls.refinements`."""
        return await self._run(self._authoring.refinements(verb, limit))

    async def cancel_refinement(self, id: str) -> Refinement:
        """As :meth:`AuthoringCalls.cancel_refinement`."""
        return await self._run(self._authoring.cancel_refinement(id))

    async def wait_refinement(
        self, id: str, *, timeout_s: float = 600.0, progress: Callable[[Refinement], object] | None = None
    ) -> Refinement:
        """As :meth:`AuthoringCalls.wait_refinement`."""
        end = time.monotonic() + timeout_s
        while True:
            job = await self.refinement(id)
            if progress is not None:
                progress(job)
            if job.ended:
                return job
            if time.monotonic() > end:
                raise _late(job, timeout_s)
            await self._sleep(FOLLOW_S)

    async def create_draft(self, content: bytes, **options: Any) -> Draft:
        """As :meth:`AuthoringCalls.create_draft`."""
        return await self._run(self._authoring.create_draft(content, options))

    async def drafts(self) -> tuple[DraftSummary, ...]:
        """As :meth:`AuthoringCalls.drafts`."""
        return await self._run(self._authoring.drafts())

    async def draft(self, id: str) -> Draft:
        """As :meth:`AuthoringCalls.draft`."""
        return await self._run(self._authoring.draft(id))

    async def change_draft(self, id: str, *, revision: int | None = None, **changes: Any) -> Draft:
        """As :meth:`AuthoringCalls.change_draft`."""
        return await self._run(self._authoring.change_draft(id, changes, revision))

    async def publish_draft(self, id: str, *, name: str | None = None, revision: int | None = None) -> Version:
        """As :meth:`AuthoringCalls.publish_draft`."""
        return await self._run(self._authoring.publish_draft(id, name, revision))

    async def delete_draft(self, id: str) -> None:
        """As :meth:`AuthoringCalls.delete_draft`."""
        await self._run(self._authoring.delete_draft(id))

    async def changes(
        self, verb: str | None = None, *, author: str | None = None, before: int | None = None, limit: int = 100
    ) -> tuple[Change, ...]:
        """As :meth:`AuthoringCalls.changes`."""
        return await self._run(self._authoring.changes(verb, author, before, limit))

    async def access(self) -> Access:
        """As :meth:`AuthoringCalls.access`."""
        return await self._run(self._authoring.access())
