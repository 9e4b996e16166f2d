"""Calls of both REST clients for files, maps of quality, and poses of drafts; the operations are in ``motion_api``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TypeVar, Unpack

from adverb_client import models
from adverb_client.api import Adverbs, Operation, PoseOptions, Track
from adverb_client.motion_api import MotionApi

__all__ = ["AsyncMotionCalls", "MotionCalls"]

T = TypeVar("T")


class MotionCalls(ABC):
    """Files, maps of quality, and poses of drafts."""

    _motions: MotionApi

    @abstractmethod
    def _run(self, operation: Operation[T]) -> T:
        """Send the requests of an operation; the clients do."""

    def export(
        self,
        verb: str,
        form: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        mannequin: bool = False,
        **options: Unpack[PoseOptions],
    ) -> bytes:
        """A whole motion as a file, with all joints and local rotations.

        Parameters
        ----------
        verb : str
        form : str
            ``bvh``, ``glb`` (glTF), ``vrma`` (VRM animation, humanoids only) or ``npz`` (NumPy).
        adverbs, track, fps, cycles
            As of ``sequence``.
        mannequin : bool
            Whether to add a simple body to a ``glb`` file.
        **options
            See :class:`PoseOptions`.

        Raises
        ------
        ValueError
            If the format is unknown.
        ResponseError, TransportError, DecodeError
            As of ``pose``.
        """
        return self._run(self._motions.export(verb, form, adverbs, track, fps, cycles, mannequin, options))

    def artifact(self, verb: str) -> bytes:
        """The artifact of the version that is served, also of a built-in verb."""
        return self._run(self._motions.artifact(verb))

    def quality(
        self,
        verb: str,
        *,
        method: str | None = None,
        across: str | None = None,
        up: str | None = None,
        at: Mapping[str, float] | None = None,
        nodes: int | None = None,
        version: int | None = None,
    ) -> models.QualityMap:
        """Maps of error, smoothness and support over a plane of two adverbs.

        Parameters
        ----------
        verb : str
        method : str, optional
            One of the verb's methods.
        across, up : str, optional
            Adverbs of the columns and rows.
        at : mapping, optional
            Values of the other adverbs.
        nodes : int, optional
            Nodes to a side, 3 to 101.
        version : int, optional
        """
        return self._run(self._motions.quality(verb, method, across, up, at, nodes, version))

    def draft_pose(
        self,
        id: str,
        adverbs: Mapping[str, float],
        *,
        phase: float | None = None,
        time_s: float | None = None,
        max_error: float | None = None,
        **options: Unpack[PoseOptions],
    ) -> models.Pose:
        """One pose of a draft's verb, as of ``pose`` with ``full``; ``version`` is the draft's revision."""
        return self._run(self._motions.draft_pose(id, adverbs, phase, time_s, max_error, options))

    def draft_sequence(
        self,
        id: str,
        adverbs: Mapping[str, float] | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[PoseOptions],
    ) -> models.Sequence:
        """A whole motion of a draft's verb, as of ``sequence`` with ``full``."""
        return self._run(self._motions.draft_sequence(id, adverbs, track, fps, cycles, options))

    def draft_motion(self, id: str) -> bytes:
        """Poses of all readable clips of a draft, for display; docs/rest.md has the layout."""
        return self._run(self._motions.draft_motion(id))

    def live(self) -> bool:
        """Liveness of the server; a live one need not be ready."""
        return self._run(self._motions.live())

    def metrics(self) -> str:
        """Metrics of the server as Prometheus text."""
        return self._run(self._motions.metrics())


class AsyncMotionCalls(ABC):
    """As :class:`MotionCalls`, asynchronously."""

    _motions: MotionApi

    @abstractmethod
    async def _run(self, operation: Operation[T]) -> T:
        """Send the requests of an operation; the clients do."""

    async def export(
        self,
        verb: str,
        form: str,
        adverbs: Adverbs | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        mannequin: bool = False,
        **options: Unpack[PoseOptions],
    ) -> bytes:
        """As :meth:`MotionCalls.export`."""
        return await self._run(self._motions.export(verb, form, adverbs, track, fps, cycles, mannequin, options))

    async def artifact(self, verb: str) -> bytes:
        """As :meth:`MotionCalls.artifact`."""
        return await self._run(self._motions.artifact(verb))

    async def quality(
        self,
        verb: str,
        *,
        method: str | None = None,
        across: str | None = None,
        up: str | None = None,
        at: Mapping[str, float] | None = None,
        nodes: int | None = None,
        version: int | None = None,
    ) -> models.QualityMap:
        """As :meth:`MotionCalls.quality`."""
        return await self._run(self._motions.quality(verb, method, across, up, at, nodes, version))

    async def draft_pose(
        self,
        id: str,
        adverbs: Mapping[str, float],
        *,
        phase: float | None = None,
        time_s: float | None = None,
        max_error: float | None = None,
        **options: Unpack[PoseOptions],
    ) -> models.Pose:
        """As :meth:`MotionCalls.draft_pose`."""
        return await self._run(self._motions.draft_pose(id, adverbs, phase, time_s, max_error, options))

    async def draft_sequence(
        self,
        id: str,
        adverbs: Mapping[str, float] | None = None,
        *,
        track: Track | None = None,
        fps: float = 30.0,
        cycles: int = 1,
        **options: Unpack[PoseOptions],
    ) -> models.Sequence:
        """As :meth:`MotionCalls.draft_sequence`."""
        return await self._run(self._motions.draft_sequence(id, adverbs, track, fps, cycles, options))

    async def draft_motion(self, id: str) -> bytes:
        """As :meth:`MotionCalls.draft_motion`."""
        return await self._run(self._motions.draft_motion(id))

    async def live(self) -> bool:
        """As :meth:`MotionCalls.live`."""
        return await self._run(self._motions.live())

    async def metrics(self) -> str:
        """As :meth:`MotionCalls.metrics`."""
        return await self._run(self._motions.metrics())
