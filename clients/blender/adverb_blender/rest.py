"""Calls of a server by urllib, which every Python has."""

from __future__ import annotations

import http.client
import json
import urllib.error
import urllib.request
from typing import Any

__all__ = ["Server", "ServerError"]

Json = dict[str, Any]

TIMEOUT_S = 10.0


class ServerError(Exception):
    """A call failed; the text is for people.

    Attributes
    ----------
    code : str
        That of the server, or ``offline``, ``malformed``, ``bad_address``.
    """

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code


class Server:
    """A server.

    Parameters
    ----------
    address : str
        http:// or https://, host and port.
    key : str
        Empty where the server requires none.
    """

    def __init__(self, address: str, key: str = "") -> None:
        self._address, self._key = address.rstrip("/"), key

    def verbs(self) -> list[str]:
        """Names of the verbs."""
        return [row["name"] for row in self._json("/v1/verbs")["verbs"]]

    def verb(self, name: str) -> Json:
        """Description of a verb: adverbs, skeleton, keytime_names, examples and more."""
        return self._json(f"/v1/verbs/{name}")

    def pose(self, verb: str, adverbs: dict[str, float], phase: float, *, plant: bool = True) -> Json:
        """One pose: root (m), rotations x, y, z, w (local), measured, error and more."""
        return self._json(f"/v1/verbs/{verb}/pose", {"adverbs": adverbs, "phase": phase, "plant": plant})

    def sequence(
        self, verb: str, adverbs: dict[str, float], fps: float, *, space: str = "local", plant: bool = True
    ) -> Json:
        """A whole motion: times (s), root, rotations; with ``space="global"`` also positions."""
        body = {"adverbs": adverbs, "fps": fps, "space": space, "plant": plant}
        return self._json(f"/v1/verbs/{verb}/sequence", body)

    def motion_file(self, verb: str, adverbs: dict[str, float], fps: float, media_type: str) -> bytes:
        """A whole motion as a file: ``text/x-bvh`` or ``model/gltf-binary``."""
        return self._call(f"/v1/verbs/{verb}/sequence", {"adverbs": adverbs, "fps": fps}, media_type)

    def _json(self, path: str, body: Json | None = None) -> Json:
        try:
            found: Json = json.loads(self._call(path, body, "application/json"))
        except ValueError as err:
            raise ServerError("malformed", f"{self._address}{path}: {err}") from None
        if not isinstance(found, dict):
            raise ServerError("malformed", f"{self._address}{path}: expected a JSON object")
        return found

    def _call(self, path: str, body: Json | None, media_type: str) -> bytes:
        headers = {"Accept": media_type}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        content = None
        if body is not None:
            headers["Content-Type"], content = "application/json", json.dumps(body).encode()
        if not self._address.startswith(("http://", "https://")):
            raise ServerError("bad_address", f"expected http:// or https://, got {self._address!r}")
        request = urllib.request.Request(self._address + path, content, headers)
        try:
            with urllib.request.urlopen(request, timeout=TIMEOUT_S) as response:
                found: bytes = response.read()
                return found
        except urllib.error.HTTPError as err:
            raise _problem(err) from None
        except (OSError, http.client.HTTPException) as err:
            raise ServerError("offline", f"{self._address}: {getattr(err, 'reason', None) or repr(err)}") from None
        except ValueError as err:
            raise ServerError("bad_address", f"{self._address}: {err}") from None


def _problem(err: urllib.error.HTTPError) -> ServerError:
    try:
        fields = json.loads(err.read())
        return ServerError(fields["code"], fields["detail"])
    except (ValueError, KeyError, TypeError, OSError, http.client.HTTPException):
        return ServerError(f"http_{err.code}", str(err.reason))
