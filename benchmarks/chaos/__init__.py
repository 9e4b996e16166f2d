"""``make chaos``: faults at random times while clients stream, request, upload and refine; see docs/chaos.md."""
