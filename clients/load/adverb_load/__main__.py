"""``python -m adverb_load``: the command ``adverb load``."""

import sys

from adverb_load.command import main

if __name__ == "__main__":
    sys.exit(main(prog="python -m adverb_load"))
