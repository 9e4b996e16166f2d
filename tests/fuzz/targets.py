"""The table of targets."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import import_module

Run = Callable[[bytes], None]


@dataclass(frozen=True, slots=True)
class Target:
    """A parser to fuzz.

    Parameters
    ----------
    parser : str
        What is parsed, for the table in docs/fuzz.md.
    module, opens, seeds : str
        Module below ``tests.fuzz``, and its functions: a context manager that gives the target, and the first inputs.
    measured : tuple of str
        Packages whose coverage guides the search.
    longest : int
        Longest input, bytes.
    """

    parser: str
    module: str
    opens: str
    seeds: str
    measured: tuple[str, ...]
    longest: int = 8_192

    def open(self) -> AbstractContextManager[Run]:
        """The function that parses one input, within a context that holds what it needs."""
        found: AbstractContextManager[Run] = getattr(import_module(f"tests.fuzz.{self.module}"), self.opens)()
        return found

    def first(self) -> Iterable[bytes]:
        """Generated inputs to begin with."""
        found: Iterable[bytes] = getattr(import_module(f"tests.fuzz.{self.module}"), self.seeds)()
        return found


_HTTP = ("service", "starlette", "jwt")

TARGETS = {
    "bvh": Target("BVH files", "files", "read_bvh", "bvh_seeds", ("verbs",)),
    "gltf": Target("glTF and GLB files", "files", "read_gltf", "gltf_seeds", ("verbs",)),
    "npz": Target("npz files", "files", "read_npz", "npz_seeds", ("verbs",)),
    "toml": Target("`verb.toml`", "files", "read_toml", "toml_seeds", ("verbs", "tomllib")),
    "zip": Target("archives of uploads", "files", "unpack_zip", "zip_seeds", ("service", "zipfile"), 65_536),
    "artifact": Target(
        "verb files, and a pose of each valid one",
        *("files", "load_artifact", "artifact_seeds"),
        *(("verbs",), 65_536),
    ),
    "models": Target("JSON bodies, by their models", "requests", "read_models", "body_seeds", ("service",)),
    "bodies": Target("JSON bodies, through the app", "requests", "read_bodies", "body_seeds", _HTTP),
    "headers": Target(
        "Range, If-Match, If-None-Match, Accept, Content-Type, by their functions",
        *("requests", "read_headers", "header_seeds", _HTTP, 2_048),
    ),
    "requests": Target(
        "the same, Host and Origin, through the app", "requests", "request_headers", "header_seeds", _HTTP, 2_048
    ),
    "tokens": Target("JSON Web Tokens, signed and not", "requests", "read_tokens", "token_seeds", _HTTP),
    "authorization": Target(
        "Authorization and `adverb.bearer`, through the app",
        *("requests", "authenticate", "authorization_seeds", _HTTP),
    ),
    "text": Target("text messages of streams", "messages", "read_text", "text_seeds", ("service",)),
    "binary": Target("binary messages of streams", "messages", "read_binary", "binary_seeds", ("service",)),
    "frames": Target(
        "WebSocket frames of streams", "messages", "read_frames", "frame_seeds", ("service", "uvicorn", "websockets")
    ),
    "session": Target(
        "messages of one session, through the app", "messages", "serve_session", "session_seeds", ("service",)
    ),
}
"""By name."""
