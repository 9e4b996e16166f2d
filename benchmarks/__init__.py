"""Benchmarks: ratios measured in one run, the minimum of many interleaved rounds. Run by ``make bench``."""
