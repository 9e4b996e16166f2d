"""Client of Adverb: poses by REST, and streams of poses with a jitter buffer.

``Client`` and ``AsyncClient`` request poses, batches of poses and whole motions. ``Stream`` and ``SyncStream`` receive
poses from the server in real time. Coordinates are right-handed, +Y up, +Z forward; metres, seconds, radians;
quaternions x, y, z, w.
"""

from adverb_client import errors
from adverb_client.api import PoseOptions
from adverb_client.async_client import AsyncClient
from adverb_client.authoring_models import Access, Change, Draft, DraftSummary, Refinement, Version
from adverb_client.backoff import Backoff
from adverb_client.channel import Channel
from adverb_client.client import Client
from adverb_client.clock import Clock, Lateness
from adverb_client.errors import AdverbError, DecodeError, ResponseError, StreamClosed, TimedOut, TransportError
from adverb_client.jitter import Delays, JitterBuffer, Sample
from adverb_client.messages import (
    BudgetReport,
    ChannelOpened,
    CommandRejected,
    ConnectionLost,
    ConnectionRestored,
    Hello,
    KeytimePassed,
    MotionEnded,
    ServerDraining,
    StreamEnded,
    StreamEvent,
    VersionChanged,
)
from adverb_client.models import (
    Adverb,
    Example,
    Health,
    KeytimeEvent,
    Mapped,
    Pose,
    Poses,
    QualityMap,
    Sequence,
    SkippedFile,
    Verb,
    VerbSummary,
)
from adverb_client.options import OpenOptions
from adverb_client.recording import Recorder, Recording
from adverb_client.session import Stats
from adverb_client.skeleton import Skeleton
from adverb_client.stream import Stream
from adverb_client.sync_stream import SyncStream
from adverb_client.wire import Layout, PoseMessage, Record, decode_message, encode_adverbs, encode_bulk_adverbs

__all__ = [
    "Access",
    "Adverb",
    "AdverbError",
    "AsyncClient",
    "Backoff",
    "BudgetReport",
    "Change",
    "Channel",
    "ChannelOpened",
    "Client",
    "Clock",
    "CommandRejected",
    "ConnectionLost",
    "ConnectionRestored",
    "DecodeError",
    "Delays",
    "Draft",
    "DraftSummary",
    "Example",
    "Health",
    "Hello",
    "JitterBuffer",
    "KeytimeEvent",
    "KeytimePassed",
    "Lateness",
    "Layout",
    "Mapped",
    "MotionEnded",
    "OpenOptions",
    "Pose",
    "PoseMessage",
    "PoseOptions",
    "Poses",
    "QualityMap",
    "Record",
    "Recorder",
    "Recording",
    "Refinement",
    "ResponseError",
    "Sample",
    "Sequence",
    "ServerDraining",
    "Skeleton",
    "SkippedFile",
    "Stats",
    "Stream",
    "StreamClosed",
    "StreamEnded",
    "StreamEvent",
    "SyncStream",
    "TimedOut",
    "TransportError",
    "Verb",
    "VerbSummary",
    "Version",
    "VersionChanged",
    "decode_message",
    "encode_adverbs",
    "encode_bulk_adverbs",
    "errors",
]
