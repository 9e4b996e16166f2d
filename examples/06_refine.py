"""Refine a verb on the server: a worker inserts pseudo-examples, and the better version is published.

Run: adverb serve, then python examples/06_refine.py [ADDRESS]
"""

from __future__ import annotations

import json
import sys

import httpx

ENDED = {"published", "not_better", "failed", "cancelled", "given_up"}


def main(address: str = "http://127.0.0.1:8000") -> None:
    """Refine the built-in verb ``arm3`` and follow the job by its server-sent events."""
    wanted = {"max_pseudo": 20, "target_error": 1e-4, "method": "refined"}
    with httpx.Client(base_url=address, timeout=120.0) as client:
        job = client.post("/v1/verbs/arm3/refinements", json=wanted).raise_for_status().json()
        with client.stream("GET", f"/v1/refinements/{job['id']}/events") as events:
            for line in events.iter_lines():
                if line.startswith("data:"):
                    job = json.loads(line.removeprefix("data:"))
                    print(f"{job['state']}: {job['progress'].get('pseudo', 0)} pseudo-examples")
                if job["state"] in ENDED:
                    break
    print(f"version {job['version_before']} to {job['version_after']}: {job['detail']}")


if __name__ == "__main__":
    main(*sys.argv[1:])
