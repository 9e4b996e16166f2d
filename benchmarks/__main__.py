"""``make bench``: every comparison in one run, the machine named above it."""

from benchmarks import poses, requests
from benchmarks.timing import machine

print(machine())
poses.main()
requests.main()
