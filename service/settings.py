"""Everything that an operator can set, each with its unit; environment variables start with ``ADVERB_``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

__all__ = ["Settings"]

LogLevel = Literal["debug", "info", "warning", "error"]


class Settings(BaseSettings):
    """Settings of one server process.

    Arguments win over environment variables, and these over the defaults. Nothing reads the environment on import:
    whoever starts a server makes one of these and hands it to :func:`service.app.create_app`.
    """

    def environment(self) -> dict[str, str]:
        """Environment variables that give another process these settings."""
        given = self.model_dump(mode="json", exclude_none=True)
        return {f"ADVERB_{name.upper()}": str(value) for name, value in given.items()}

    @property
    def database(self) -> str:
        """Address of the database; there is one where there is a data folder."""
        assert self.data is not None  # asked for by whoever keeps versions
        return self.database_url or f"sqlite:///{self.data.resolve() / 'state.db'}"

    @property
    def artifacts(self) -> str:
        """Address of the artifacts."""
        assert self.data is not None  # asked for by whoever keeps versions
        return self.artifact_url or str(self.data.resolve() / "artifacts")

    model_config = SettingsConfigDict(env_prefix="ADVERB_", extra="ignore", frozen=True, env_ignore_empty=True)

    host: Annotated[str, Field(min_length=1, max_length=253, description="Address to listen on.")] = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65_535, description="Port to listen on; 0 takes a free one.")] = 8000
    workers: Annotated[
        int,
        Field(
            ge=1,
            le=256,
            description="Server processes that share the port (Linux). Limits on streams and threads hold for each.",
        ),
    ] = 1
    allow_public: Annotated[
        bool,
        Field(
            description="Yes, listen on an address that other machines can reach, although there are no keys: anyone "
            "who reaches it may use it."
        ),
    ] = False
    allowed_hosts: Annotated[
        str,
        Field(
            max_length=4_000,
            description="Names under which clients reach the server, separated by commas; * allows any. IP addresses, "
            "localhost, the machine's name and `ADVERB_HOST` are always allowed.",
        ),
    ] = ""
    data: Annotated[
        Path | None,
        Field(
            description="Folder in which versions of verbs are kept; verbs that lie there as files (*.verb) are taken "
            "in at the start. Without one the built-in verbs are served, and nothing can be changed."
        ),
    ] = None
    database_url: Annotated[
        str | None,
        Field(description="Database of versions and jobs: postgresql://…; by default SQLite in the data folder."),
    ] = None
    artifact_url: Annotated[
        str | None,
        Field(description="Where artifacts are kept: a folder, or s3://bucket/prefix; by default in the data folder."),
    ] = None
    refiners: Annotated[
        int, Field(ge=0, le=64, description="Processes that refine verbs, started beside the server.")
    ] = 1
    refine_above: Annotated[
        float | None,
        Field(
            gt=0,
            le=1,
            description="Mean error of a verb's answers beyond which it is refined without being asked, as a share of "
            "the diagonal of its examples' goals (0.01 is one percent); never, where it is not given.",
        ),
    ] = None
    max_upload_bytes: Annotated[
        int, Field(ge=1_024, le=1024**3, description="Longest uploaded verb or zip of a verb source, bytes.")
    ] = 256 * 1024 * 1024
    log_level: Annotated[LogLevel, Field(description="Least severe message to log: debug, info, warning, error.")] = (
        "info"
    )
    log_json: Annotated[bool, Field(description="Log one JSON object a line instead of text for people.")] = False
    max_body_bytes: Annotated[
        int, Field(ge=1_024, le=256 * 1024 * 1024, description="Longest request body, bytes.")
    ] = 1024 * 1024
    max_batch: Annotated[
        int, Field(ge=1, le=100_000, description="Most poses in one binary call of the poses route.")
    ] = 10_000
    max_batch_json: Annotated[
        int,
        Field(
            ge=1,
            le=10_000,
            description="Most poses in one JSON call of the poses route; reading JSON holds up every other request, "
            "about 3 µs a pose.",
        ),
    ] = 1_000
    max_sequence_frames: Annotated[
        int, Field(ge=1, le=100_000, description="Most frames in one answer of the sequence route.")
    ] = 10_000
    compute_threads: Annotated[
        int,
        Field(ge=1, le=64, description="Threads for batches and sequences that take longer than half a millisecond."),
    ] = 2
    max_waiting: Annotated[
        int, Field(ge=0, le=10_000, description="Most such calls that wait for a thread; more are answered 503.")
    ] = 64
    streams: Annotated[int, Field(ge=1, le=100_000, description="Most streams (WebSockets) at a time.")] = 2_000
    stream_channels: Annotated[int, Field(ge=1, le=65_536, description="Most channels (characters) of a stream.")] = (
        1_024
    )
    stream_characters: Annotated[
        int, Field(ge=1, le=1_000_000, description="Most channels (characters) of all streams together.")
    ] = 20_000
    stream_grace_s: Annotated[
        float, Field(ge=0, le=600, description="How long a stream that lost its connection can be resumed, seconds.")
    ] = 10.0
    stream_slow_s: Annotated[
        float,
        Field(gt=0, le=600, description="Seconds for which a stream's client may read nothing before it is cut off."),
    ] = 30.0
    shutdown_s: Annotated[
        int, Field(ge=0, le=600, description="Longest wait for running requests when asked to stop, seconds.")
    ] = 10
