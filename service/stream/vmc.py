"""Poses of channels to receivers of VMC, the Virtual Motion Capture protocol (UDP), which the operator names.

A client chooses one of the names and never an address: a server that sends to any address for anyone would be a tool of
attacks. Everything but :meth:`Receivers.of` runs in the engine's thread.
"""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Any

import numpy as np

from service.settings import receivers_of
from verbs.errors import OutOfRange, UnknownName
from verbs.io.vmc import VmcPackets, address_of
from verbs.runtime.characters import Characters
from verbs.skeleton import Skeleton

__all__ = ["MAX_SENDERS", "Receivers", "Sender"]

MAX_SENDERS = 16
"""Channels of a server whose poses are sent; each costs a tenth of a millisecond a frame."""

MAX_SKELETONS = 4
"""Skeletons whose packets a sender keeps, as a channel switches between verbs."""

Address = tuple[socket.AddressFamily, Any]


class Receivers:
    """The receivers of a server.

    Parameters
    ----------
    text : str
        See :func:`service.settings.receivers_of`.

    Raises
    ------
    RequestError
        A host is not known, or an address is invalid.
    """

    def __init__(self, text: str) -> None:
        self._addresses: dict[str, Address] = {name: address_of(to) for name, to in receivers_of(text).items()}
        self._sockets: dict[socket.AddressFamily, socket.socket] = {}
        self.senders = 0

    def sender(self, name: str) -> Sender:
        """A sender to a receiver; raises :class:`UnknownName`, or :class:`OutOfRange` beyond :data:`MAX_SENDERS`."""
        if name not in self._addresses:
            raise UnknownName("VMC receiver", name, self._addresses)
        if self.senders >= MAX_SENDERS:
            raise OutOfRange(f"the server sends at most {MAX_SENDERS} channels to VMC receivers")
        family, address = self._addresses[name]
        if family not in self._sockets:
            self._sockets[family] = socket.socket(family, socket.SOCK_DGRAM)
            self._sockets[family].setblocking(False)
        return Sender(self, self._sockets[family], address)

    def close(self) -> None:
        """Close the sockets."""
        for opened in self._sockets.values():
            opened.close()


class Sender:
    """Sends the poses of one channel; counted until :meth:`close`.

    Parameters
    ----------
    receivers : Receivers
    opened : socket
        Without waiting.
    address : tuple
    """

    def __init__(self, receivers: Receivers, opened: socket.socket, address: Any) -> None:
        self._receivers, self._socket, self._address = receivers, opened, address
        self._packets: dict[Skeleton, VmcPackets] = {}
        self._began_s: float | None = None
        receivers.senders += 1

    def fit(self, skeleton: Skeleton) -> None:
        """Prepare the packets of a skeleton; raises :class:`RequestError` for one that is no humanoid."""
        if skeleton in self._packets:
            return
        if len(self._packets) >= MAX_SKELETONS:
            self._packets.clear()
        self._packets[skeleton] = VmcPackets(skeleton)

    def send(self, characters: Characters, slot: int, due_s: float) -> None:
        """Send the displayed pose of a character; what the network does not take at once is lost."""
        self._began_s = due_s if self._began_s is None else self._began_s
        pose = characters.displayed(np.array([slot]))[0]
        self.fit(characters.verb.skeleton)
        for packet in self._packets[characters.verb.skeleton].pack(
            pose[:3], pose[3:].reshape(-1, 4), due_s - self._began_s
        ):
            with suppress(OSError):
                self._socket.sendto(packet, self._address)

    def close(self) -> None:
        """Count no more."""
        self._receivers.senders -= 1
