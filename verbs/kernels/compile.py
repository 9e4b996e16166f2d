"""The one way in which kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

__all__ = ["kernel"]

REORDER = {"reassoc", "contract", "arcp", "nsz"}

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function at its first call, without the interpreter lock, and keep the result on disk.

    Division by zero gives infinity as in NumPy: kernels raise nothing of their own. Sums may be taken in another order
    than written, so that they vectorise; NaN and infinity keep their meaning.
    """
    return cast(Function, njit(nogil=True, cache=True, error_model="numpy", fastmath=REORDER)(function))
