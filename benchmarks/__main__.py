"""``make bench``: every comparison in one run, the machine named above it."""

from benchmarks import crowd, inverse_kinematics, lists, planting, poses, requests, weights
from benchmarks.timing import machine

print(machine())
for part in (poses, planting, weights, requests, crowd, inverse_kinematics, lists):
    part.main()
