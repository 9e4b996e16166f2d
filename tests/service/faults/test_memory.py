"""A worker that gets no more memory. One that the system kills for want of it: `test_takeover.py`."""

import resource
from pathlib import Path

import pytest

from service import cli
from service.refinement.worker import steps
from tests.service.catalog.conftest import PATIENCE_S, Kept, client_of, until
from tests.service.conftest import ARM
from tests.warm import lives

pytestmark = [pytest.mark.anyio]

SPARE_BYTES = 64 * 1024**2


def starving() -> None:
    """`adverb worker` whose refinements of arm3 need more memory than it may have."""
    resume = steps.resume_refinement

    def starve(verb, *arguments, **options):
        if verb.name != "arm3":
            return resume(verb, *arguments, **options)
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + SPARE_BYTES, hard))
        try:
            return bytearray(10 * SPARE_BYTES)
        finally:
            resource.setrlimit(resource.RLIMIT_AS, (hard, hard))

    steps.resume_refinement = starve
    cli.main()


async def test_a_refinement_without_memory_fails_and_its_worker_continues(warm, tmp_path):
    server = Kept(data=tmp_path, refiners=0).start(PATIENCE_S)
    worker = warm.start("worker", "--data", str(tmp_path), "--name", "small", target=f"{__name__}:starving")
    try:
        async with client_of(server) as client:

            async def ended(verb):
                job = (
                    await client.post(f"/v1/verbs/{verb}/refinements", json={"max_pseudo": 1, "target_error": 1e-6})
                ).json()
                where = f"/v1/refinements/{job['id']}"
                return await until(client, where, lambda row: row["state"] not in ("queued", "running"))

            job = await ended("arm3")
            assert (job["state"], job["version_after"]) == ("failed", None)
            assert "MemoryError" in job["detail"]
            assert (await client.get("/v1/verbs/arm3/versions")).json()["current"] == 1
            assert (await ended("board"))["state"] in ("published", "not_better")
            assert lives(worker.pid)
            assert (await client.post("/v1/verbs/arm3/pose", json={"adverbs": ARM})).status_code == 200
    finally:
        worker.end()
        server.stop()
