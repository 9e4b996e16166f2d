"""Settings of the server with their units; environment variables start with ``ADVERB_``."""

from __future__ import annotations

import ipaddress
import socket
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

__all__ = ["Settings", "origins_of", "receivers_of"]

LogLevel = Literal["debug", "info", "warning", "error"]
KeysMode = Literal["auto", "required", "off"]


def origins_of(listed: str) -> frozenset[str]:
    """Origins of web pages in a list that is separated by commas; ``*`` stands for any.

    Raises
    ------
    ValueError
        An entry is no origin: scheme, name and perhaps a port.
    """
    found = set()
    for entry in (part.strip() for part in listed.split(",")):
        parts = urlsplit(entry)
        plain = f"{parts.scheme}://{parts.netloc}"
        fits = (
            parts.scheme in ("http", "https")
            and parts.hostname
            and entry.lower() in (plain.lower(), f"{plain}/".lower())
        )
        if entry and entry != "*" and (not fits or "@" in entry):
            raise ValueError(f"{entry[:100]!r} is not an origin; write https://game.example or http://localhost:5173")
        if entry:
            found.add("*" if entry == "*" else plain.lower())
    return frozenset(found)


def receivers_of(text: str) -> dict[str, str]:
    """Addresses by name, of ``name=host:port`` separated by commas; raises :class:`ValueError`."""
    found = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, equals, address = part.partition("=")
        if not equals or not name.strip() or not address.strip():
            raise ValueError(f"'{part:.100}' is no receiver; write NAME=HOST:PORT")
        found[name.strip()] = address.strip()
    return found


class Settings(BaseSettings):
    """Settings of one server process.

    Arguments take precedence over environment variables, and these over the defaults. The environment is read when an
    instance is created, never on import.
    """

    def environment(self) -> dict[str, str]:
        """Environment variables that pass these settings to another process."""
        given = self.model_dump(mode="json", exclude_none=True)
        return {f"ADVERB_{name.upper()}": str(value) for name, value in given.items()}

    @property
    def database(self) -> str:
        """Address of the database; requires a data folder."""
        assert self.data is not None  # callers check it
        return self.database_url or f"sqlite:///{self.data.resolve() / 'state.db'}"

    @property
    def artifacts(self) -> str:
        """Address of the artifacts; requires a data folder."""
        assert self.data is not None  # callers check it
        return self.artifact_url or str(self.data.resolve() / "artifacts")

    @property
    def public(self) -> bool:
        """Whether other machines can reach a server that listens on the host; true where it is not known."""
        try:
            found = socket.getaddrinfo(self.host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        except OSError:
            return True
        return not all(ipaddress.ip_address(str(row[4][0]).partition("%")[0]).is_loopback for row in found)

    model_config = SettingsConfigDict(env_prefix="ADVERB_", extra="ignore", frozen=True, env_ignore_empty=True)

    host: Annotated[str, Field(min_length=1, max_length=253, description="Address to listen on.")] = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65_535, description="Port to listen on; 0 takes a free one.")] = 8000
    workers: Annotated[
        int,
        Field(
            ge=1,
            le=256,
            description="Server processes that share the port (Linux). Limits on streams and threads are per process.",
        ),
    ] = 1
    allow_public: Annotated[
        bool,
        Field(description="Allow a public address without keys: anyone who can reach the server can use it."),
    ] = False
    keys: Annotated[
        KeysMode,
        Field(
            description="Whether requests need an API key. auto: as soon as a key exists, tokens are configured, or "
            "other machines can reach the server; required; off."
        ),
    ] = "auto"
    open_metrics: Annotated[bool, Field(description="Answer `/metrics` without a key.")] = False
    open_docs: Annotated[bool, Field(description="Answer `/docs` and `/openapi.json` without a key.")] = False
    jwt_jwks: Annotated[
        str | None,
        Field(
            min_length=1,
            max_length=2_000,
            description="File or URL of the JSON Web Key Set of an issuer whose tokens are accepted beside keys.",
        ),
    ] = None
    jwt_issuer: Annotated[str | None, Field(max_length=2_000, description="Required claim `iss` of tokens.")] = None
    jwt_audience: Annotated[str | None, Field(max_length=2_000, description="Required claim `aud` of tokens.")] = None
    jwt_scope_claim: Annotated[
        str, Field(min_length=1, max_length=200, description="Claim of tokens with their scopes.")
    ] = "scope"
    allowed_hosts: Annotated[
        str,
        Field(
            max_length=4_000,
            description="Names under which clients reach the server, separated by commas; * allows any. IP addresses, "
            "localhost, the machine's name and `ADVERB_HOST` are always allowed.",
        ),
    ] = ""
    cors_origins: Annotated[
        str,
        Field(
            max_length=4_000,
            description="Origins of web pages that may use the API and streams besides the server's own page, "
            "separated by commas (https://game.example); * allows any page. Also the address of the server's own page "
            "where a proxy replaces `Host`.",
        ),
    ] = ""
    frame_ancestors: Annotated[
        str,
        Field(
            max_length=4_000,
            description="Origins of web pages that may show this server's pages in a frame, separated by commas. "
            "Default: only the server's own.",
        ),
    ] = ""
    data: Annotated[
        Path | None,
        Field(
            description="Folder of versions of verbs. Files *.verb in it are published at the start. Without a folder "
            "the server is read-only and serves the built-in verbs."
        ),
    ] = None
    database_url: Annotated[
        str | None,
        Field(description="Database of versions and jobs: postgresql://…; by default SQLite in the data folder."),
    ] = None
    artifact_url: Annotated[
        str | None,
        Field(description="Address of the artifacts: a folder, or s3://bucket/prefix; by default in the data folder."),
    ] = None
    refiners: Annotated[
        int, Field(ge=0, le=64, description="Worker processes for refinements, started with the server.")
    ] = 1
    refine_above: Annotated[
        float | None,
        Field(
            gt=0,
            le=1,
            description="Mean error of a verb's poses above which a refinement starts automatically, as a share of the "
            "diagonal of its examples' goals (0.01 is one percent). Unset: never.",
        ),
    ] = None
    max_upload_bytes: Annotated[
        int, Field(ge=1_024, le=1024**3, description="Largest upload of a verb or of a zip of a verb source, bytes.")
    ] = 256 * 1024 * 1024
    max_drafts: Annotated[
        int, Field(ge=0, le=10_000, description="Largest number of drafts, of all servers with one database.")
    ] = 100
    max_drafts_bytes: Annotated[
        int, Field(ge=0, le=1024**4, description="Largest size of all drafts with their clips and verbs, bytes.")
    ] = 4 * 1024**3
    draft_days: Annotated[
        float, Field(gt=0, le=3_650, description="Days after its last change at which a draft is removed.")
    ] = 30.0
    rate_per_key: Annotated[
        str,
        Field(
            max_length=200, description="Largest rate of requests of one key or token: 100/second; 5000/minute; none."
        ),
    ] = ""
    rate_per_address: Annotated[
        str, Field(max_length=200, description="Largest rate of requests of one address, in the same form.")
    ] = ""
    rate_storage: Annotated[
        str,
        Field(
            pattern="^(memory://|rediss?://.+)$",
            max_length=2_000,
            description="Where requests are counted: memory://, by each process; redis://HOST, for all together.",
        ),
    ] = "memory://"
    streams_per_key: Annotated[
        int | None, Field(ge=1, le=100_000, description="Largest number of open streams of one key, per process.")
    ] = None
    streams_per_address: Annotated[
        int | None, Field(ge=1, le=100_000, description="Largest number of open streams of one address, per process.")
    ] = None
    channels_per_key: Annotated[
        int | None,
        Field(ge=1, le=1_000_000, description="Largest number of channels of all streams of one key, per process."),
    ] = None
    refine_s_per_day: Annotated[
        int | None,
        Field(
            ge=1,
            le=10_000_000,
            description="Largest sum of the budgets of refinements that one key starts in a day, seconds; counted "
            "by each process since its start, or for all together where `ADVERB_RATE_STORAGE` is redis.",
        ),
    ] = None
    request_s: Annotated[
        float,
        Field(gt=0, le=3_600, description="Longest time in which the head of a request must arrive, seconds."),
    ] = 10.0
    log_level: Annotated[LogLevel, Field(description="Lowest level of log messages: debug, info, warning, error.")] = (
        "info"
    )
    log_json: Annotated[bool, Field(description="Log one JSON object per line instead of text.")] = False
    traces_url: Annotated[
        str | None,
        Field(
            pattern="^https?://[^/?#@]+[^?#@]*$",
            max_length=2_000,
            description="Address of an OpenTelemetry collector that receives traces by OTLP over HTTP "
            "(http://collector:4318); needs the extra `traces`. Unset: there are none.",
        ),
    ] = None
    traces_share: Annotated[
        float,
        Field(
            ge=0, le=1, description="Share of requests and streams that are traced where the caller does not decide."
        ),
    ] = 0.1
    max_body_bytes: Annotated[
        int, Field(ge=1_024, le=256 * 1024 * 1024, description="Largest request body, bytes.")
    ] = 1024 * 1024
    max_batch: Annotated[
        int, Field(ge=1, le=100_000, description="Largest number of poses in a binary request to the poses route.")
    ] = 10_000
    max_batch_json: Annotated[
        int,
        Field(
            ge=1,
            le=10_000,
            description="Largest number of poses in a JSON request to the poses route; parsing JSON blocks other "
            "requests, about 3 µs per pose.",
        ),
    ] = 1_000
    max_sequence_frames: Annotated[
        int, Field(ge=1, le=100_000, description="Largest number of frames in a response of the sequence route.")
    ] = 10_000
    compute_threads: Annotated[
        int,
        Field(ge=1, le=64, description="Threads for batches and sequences that take longer than half a millisecond."),
    ] = 2
    max_waiting: Annotated[
        int, Field(ge=0, le=10_000, description="Largest queue of such calls; further ones return 503.")
    ] = 64
    streams: Annotated[int, Field(ge=1, le=100_000, description="Largest number of open streams (WebSockets).")] = 2_000
    stream_channels: Annotated[
        int, Field(ge=1, le=65_535, description="Largest number of channels (characters) per stream.")
    ] = 2_048
    stream_characters: Annotated[
        int, Field(ge=1, le=1_000_000, description="Largest number of channels (characters) of all streams.")
    ] = 20_000
    vmc: Annotated[
        str,
        Field(
            max_length=2_000,
            description="Receivers of the Virtual Motion Capture protocol by name, separated by commas "
            "(`stage=192.168.1.20:39539`). A stream's `open` names the one that its channel's poses are sent to.",
        ),
    ] = ""
    stream_grace_s: Annotated[
        float,
        Field(ge=0, le=600, description="Time in which a stream can be resumed after its connection is lost, seconds."),
    ] = 10.0
    stream_slow_s: Annotated[
        float,
        Field(
            gt=0,
            le=600,
            description="Time after which a client that reads nothing is disconnected, seconds; of responses, the "
            "interval in which a client must read 1,000 bytes a second on average.",
        ),
    ] = 30.0
    shutdown_s: Annotated[
        int, Field(ge=0, le=600, description="Longest wait for running requests at shutdown, seconds.")
    ] = 10

    @field_validator("rate_per_key", "rate_per_address")
    @classmethod
    def _rates(cls, value: str) -> str:
        if value:
            from limits import parse_many

            try:
                parse_many(value)
            except ValueError as err:
                raise ValueError(f"{value!r} is not a rate; write 100/second, or 5000/minute") from err
        return value

    @field_validator("vmc")
    @classmethod
    def _receivers(cls, value: str) -> str:
        receivers_of(value)
        return value

    @field_validator("cors_origins", "frame_ancestors")
    @classmethod
    def _origins(cls, value: str) -> str:
        origins_of(value)
        return value
