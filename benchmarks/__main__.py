"""``make bench``: every comparison in one run, the machine named above it."""

from benchmarks import crowd, inverse_kinematics, lists, poses, requests
from benchmarks.timing import machine

print(machine())
for part in (poses, requests, crowd, inverse_kinematics, lists):
    part.main()
