"""The one way in which kernels are compiled."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

from numba import config, njit

__all__ = ["kernel"]


def _sources() -> str:
    """Names the kernels' sources as they are now."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


# Numba compiles a kernel again where its own file changed, but not where one that it calls, and holds inlined, did.
if config.CACHE_DIR:  # type: ignore[attr-defined]
    config.CACHE_DIR = str(Path(config.CACHE_DIR) / _sources())  # type: ignore[attr-defined]

REORDER = {"reassoc", "contract", "arcp", "nsz"}

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function at its first call, without the interpreter lock, and keep the result on disk.

    Division by zero gives infinity as in NumPy: kernels raise nothing of their own. Sums may be taken in another order
    than written, so that they vectorise; NaN and infinity keep their meaning.
    """
    return cast(Function, njit(nogil=True, cache=True, error_model="numpy", fastmath=REORDER)(function))
