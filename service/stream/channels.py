"""Channels: characters are opened, changed, switched, closed, and continued with new versions of their verbs.

Everything here runs in the engine's thread, between two ticks.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from typing import Any

from service.catalog.catalog import Catalog, Entry
from service.errors import ChannelInUse, TooManyChannels
from service.settings import Settings
from service.stream.channel import opened
from service.stream.group import Form, Group
from service.stream.messages import Open, Set, Switch
from service.stream.session import Channel, Session
from service.stream.ticks import Ticks
from service.stream.vmc import Receivers, Sender
from service.wire import NEW_VERSION, Layout
from verbs.errors import VerbError
from verbs.runtime.characters import VERSION_S

__all__ = ["Channels"]

RENEW_S = 0.004
"""Time in which channels are moved to new versions before each tick, seconds; the others follow after the tick."""


class Channels:
    """The characters of a server, in groups.

    Parameters
    ----------
    settings : Settings
    catalog : callable
        Gives the verbs that are served now; raises :class:`service.errors.NotReady`.
    ticks : Ticks
    send : callable
        Sends a text message to a session.

    Attributes
    ----------
    groups : dict
        By verb, version and method.
    receivers : Receivers
        Of VMC.
    on_characters : callable
        Called when the number of characters has changed.
    """

    def __init__(
        self,
        settings: Settings,
        catalog: Callable[[], Catalog],
        ticks: Ticks,
        send: Callable[[Session, dict[str, Any]], None],
    ) -> None:
        self._settings, self._catalog, self._ticks, self._send = settings, catalog, ticks, send
        self.on_characters: Callable[[], None] = lambda: None
        self.groups: dict[tuple[str, int, str], Group] = {}
        self.receivers = Receivers(settings.vmc)
        self._of_key: Counter[str] = Counter()
        self._renewing: deque[tuple[Channel, Catalog]] = deque()

    # ── messages of clients ──────────────────────────────────────────────────────────────────────────────────────

    def open(self, session: Session, request: Open) -> None:
        """Start a character."""
        if request.channel in session.channels:
            raise ChannelInUse(f"channel {request.channel} is already open; close it first, or switch it")
        if len(session.channels) >= self._settings.stream_channels:
            raise TooManyChannels(f"a stream may have at most {self._settings.stream_channels} channels")
        if self._ticks.characters >= self._settings.stream_characters:
            raise TooManyChannels(f"the server has its maximum of {self._settings.stream_characters} channels")
        most = self._settings.channels_per_key
        if most is not None and session.caller and self._of_key[session.caller] >= most:
            raise TooManyChannels(f"the key of this stream has its maximum of {most} channels")
        entry = self._catalog().entry(request.verb)
        group = self._group(entry, request.method)
        form = Form.of(request)
        layout = group.layout(form)
        vmc = None if request.vmc is None else self._sender(request.vmc, entry)
        try:
            slot = group.characters.add(
                request.adverbs,
                phase=request.phase,
                speed=request.speed,
                playing=request.play,
                looping=request.loop,
                half_life_s=request.half_life,
                following=request.follow,
                plant=request.plant,
            )
        except Exception:
            if vmc is not None:
                vmc.close()
            raise
        channel = Channel(
            *(request.channel, session, group, slot, request.fps, layout, form),
            events=request.events,
            support=request.support,
            changes=request.send == "changes",
            priority=request.priority,
            vmc=vmc,
        )
        session.channels[request.channel] = channel
        session.thinned += channel.changes
        self._of_key[session.caller] += 1
        self._ticks.add(session, channel.fps, time.monotonic())
        self.on_characters()
        self._send(session, opened(channel))

    def set(self, session: Session, request: Set) -> None:
        """Change a character."""
        channel = session.channel(request.channel)
        characters, slot = channel.group.characters, channel.slot
        channel.wake()
        row = None
        if request.adverbs is not None:
            names = [adverb.name for adverb in characters.verb.adverbs]
            now = dict(zip(names, characters.goals[slot].tolist(), strict=True))
            row = characters.row({**now, **request.adverbs})
        characters.set(
            slot,
            phase=request.phase,
            speed=request.speed,
            playing=request.play,
            looping=request.loop,
            half_life_s=request.half_life,
            following=request.follow,
        )
        if row is not None:
            characters.aim(slot, row)
        if request.priority is not None:
            channel.priority = request.priority
        if request.fps is not None and request.fps != channel.fps:
            self._ticks.drop(session, channel.fps)
            channel.fps = request.fps
            self._ticks.add(session, channel.fps, time.monotonic())

    def switch(self, session: Session, request: Switch) -> None:
        """Switch a character to another verb."""
        channel = session.channel(request.channel)
        entry = self._catalog().entry(request.verb)
        group = self._group(entry, request.method)
        layout = group.layout(channel.form)
        if channel.vmc is not None:
            channel.vmc.fit(entry.verb.skeleton)
        channel.wake()
        slot = group.characters.go_on(
            *(channel.group.characters, channel.slot, request.adverbs),
            phase=request.phase,
            transition_s=request.transition_s,
        )
        self._move(channel, group, slot, layout)
        self._send(session, opened(channel))

    def close(self, session: Session, number: int) -> None:
        """End a character."""
        channel = session.channels.pop(number)
        session.thinned -= channel.changes
        self._of_key[session.caller] -= 1
        if self._of_key[session.caller] <= 0:
            del self._of_key[session.caller]
        self._ticks.drop(session, channel.fps)
        channel.remove()
        if channel.vmc is not None:
            channel.vmc.close()
        self.on_characters()

    # ── versions ─────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def renewing(self) -> bool:
        """Whether channels wait for a new version."""
        return bool(self._renewing)

    def renew_all(self, catalog: Catalog, sessions: Iterable[Session]) -> None:
        """Continue characters with the versions of a new catalog, some now and the others between the next ticks."""
        channels = [channel for session in sessions for channel in session.channels.values()]
        self._renewing = deque((channel, catalog) for channel in channels)
        self.renew_some()

    def renew_some(self) -> None:
        """Move channels to new versions for :data:`RENEW_S`."""
        end_s = time.monotonic() + RENEW_S
        while self._renewing and time.monotonic() < end_s:
            channel, catalog = self._renewing.popleft()
            if channel.session.channels.get(channel.number) is channel:
                self._renew(channel, catalog)
        if not self._renewing:
            self.groups = {key: group for key, group in self.groups.items() if len(group.characters)}

    def _renew(self, channel: Channel, catalog: Catalog) -> None:
        was = channel.group
        entry = catalog.entries.get(was.entry.verb.name)
        if entry is None or entry is was.entry:
            return  # a verb that is no longer served plays to its end
        try:
            group = self._group(entry, was.characters.method)
            layout = group.layout(channel.form)
            if _names(entry) != _names(was.entry):
                raise VerbError(f"its adverbs are {', '.join(_names(entry))}")
            if channel.vmc is not None:
                channel.vmc.fit(entry.verb.skeleton)
            channel.wake()
            slot = group.characters.go_on(was.characters, channel.slot, transition_s=VERSION_S, same=True)
        except VerbError as err:
            detail = f"version {entry.version} of '{entry.verb.name}' cannot continue this channel: {err}"
            self._send(
                channel.session,
                {"op": "error", "channel": channel.number, "code": "bad_request", "detail": detail},
            )
            return
        channel.flags |= NEW_VERSION
        self._move(channel, group, slot, layout)
        self._send(
            channel.session,
            {"op": "version", "channel": channel.number, "version": entry.version, "record_bytes": 4 * layout.words},
        )

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _sender(self, name: str, entry: Entry) -> Sender:
        """A sender of the poses of a verb."""
        sender = self.receivers.sender(name)
        try:
            sender.fit(entry.verb.skeleton)
        except VerbError:
            sender.close()
            raise
        return sender

    def _move(self, channel: Channel, group: Group, slot: int, layout: Layout) -> None:
        channel.remove()
        channel.group, channel.slot, channel.layout = group, slot, layout
        self._ticks.changed(channel.session)

    def _group(self, entry: Entry, method: str | None) -> Group:
        entry.check(method=method)
        name = entry.evaluator.method(method)[0]
        whole = entry.verb.name, entry.version, name
        found = self.groups.get(whole)
        if found is None or found.entry is not entry:
            found = self.groups[whole] = Group(entry, name)
        return found


def _names(entry: Entry) -> list[str]:
    return [adverb.name for adverb in entry.verb.adverbs]
