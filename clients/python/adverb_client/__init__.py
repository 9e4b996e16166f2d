"""Client of Adverb: poses by REST, and streams of them with a jitter buffer for games.

``Client`` and ``AsyncClient`` ask for poses, crowds and whole motions; ``Stream`` and ``SyncStream`` let the server
send them as time goes by. Right-handed, +Y up, +Z forward; metres, seconds, radians; quaternions x, y, z, w.
"""

from adverb_client import errors
from adverb_client.api import Options
from adverb_client.async_client import AsyncClient
from adverb_client.backoff import Backoff
from adverb_client.channel import Channel, OpenOptions
from adverb_client.client import Client
from adverb_client.clock import Clock, Lateness
from adverb_client.errors import AdverbError, DecodeError, Refused, StreamClosed, TimedOut, TransportError
from adverb_client.jitter import Delays, JitterBuffer, Sample
from adverb_client.messages import (
    Closed,
    Draining,
    Ended,
    Found,
    Hello,
    Lost,
    Note,
    Opened,
    Passed,
    Published,
    Rejected,
)
from adverb_client.models import (
    Adverb,
    Event,
    Example,
    Health,
    Pose,
    Poses,
    Sequence,
    Skipped,
    Verb,
    VerbSummary,
)
from adverb_client.session import Stats
from adverb_client.skeleton import Skeleton
from adverb_client.stream import Stream
from adverb_client.sync_stream import SyncStream
from adverb_client.wire import Layout, Message, Record, decode_message, encode_adverbs

__all__ = [
    "Adverb",
    "AdverbError",
    "AsyncClient",
    "Backoff",
    "Channel",
    "Client",
    "Clock",
    "Closed",
    "DecodeError",
    "Delays",
    "Draining",
    "Ended",
    "Event",
    "Example",
    "Found",
    "Health",
    "Hello",
    "JitterBuffer",
    "Lateness",
    "Layout",
    "Lost",
    "Message",
    "Note",
    "OpenOptions",
    "Opened",
    "Options",
    "Passed",
    "Pose",
    "Poses",
    "Published",
    "Record",
    "Refused",
    "Rejected",
    "Sample",
    "Sequence",
    "Skeleton",
    "Skipped",
    "Stats",
    "Stream",
    "StreamClosed",
    "SyncStream",
    "TimedOut",
    "TransportError",
    "Verb",
    "VerbSummary",
    "decode_message",
    "encode_adverbs",
    "errors",
]
