"""Compilation of kernels, the cache of compiled kernels on disk, and calls without type resolution.

A kernel is a function that Numba compiles. Compiled code contains the kernels that it calls and the constants that it
uses. A cache entry is therefore named by a digest of all of these: the function's own bytecode, the values of the
module constants that it reads, and the same for every function that it calls, in whichever module. Editing a kernel
compiles it and its callers again, and nothing else; comments, docstrings and file times do not count.

Entries are kept in ``NUMBA_CACHE_DIR``, else beside the source, else in the user's cache folder.

This is the only file that uses private parts of Numba; ``tests/verbs/kernels/test_compile.py`` fails when they change.
"""

from __future__ import annotations

import dis
import hashlib
import warnings
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cache, cached_property
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import njit, typeof
from numba.core import caching
from numba.core.dispatcher import Dispatcher
from numba.core.types import Array, BaseTuple

__all__ = ["digest", "direct", "entry_point", "kernel"]

REORDER = {"reassoc", "contract", "arcp", "nsz"}
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": REORDER}

LIBRARIES = ("builtins", "math", "numba", "numpy")
"""Packages whose functions are known by name; their versions are part of every digest."""

_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(...))

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function at its first call, without the interpreter lock, and keep the result on disk.

    Division by zero gives infinity as in NumPy: kernels raise nothing of their own. Sums may be taken in another order
    than written, so that they vectorise; NaN and infinity keep their meaning.
    """
    dispatcher = njit(**OPTIONS)(function)
    if isinstance(dispatcher, Dispatcher):  # with NUMBA_DISABLE_JIT it is the function itself
        dispatcher._cache = _LazyCache(dispatcher.py_func)  # type: ignore[attr-defined]
    return cast(Function, dispatcher)


def direct(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel as a function that resolves argument types in its first call only.

    To resolve the types of named tuples takes longer than many kernels run. All calls must have arguments of the types
    of the first one: data type, dimensions and memory order of arrays, classes of named tuples. Nothing checks them.
    """
    entry: Callable[..., Any] | None = None

    def call(*arguments: object) -> Any:
        nonlocal entry
        if entry is None:
            entry = entry_point(function, *arguments)
        return entry(*arguments)

    return call


def entry_point(function: Callable[..., Any], *arguments: object) -> Callable[..., Any]:
    """Compiled code of a kernel for arguments of these types, as a function without keywords and without checks.

    Arrays that are arguments themselves count as writeable: code for read-only ones could differ in the last bit.
    """
    if not isinstance(function, Dispatcher):  # NUMBA_DISABLE_JIT
        return function
    types = [typeof(argument) for argument in arguments]  # type: ignore[no-untyped-call]
    return function.compile(tuple(kind.copy(readonly=False) if isinstance(kind, Array) else kind for kind in types))


def digest(function: FunctionType) -> str:
    """Name for everything that the compiled code of a function depends on, argument types aside.

    Raises
    ------
    TypeError
        The function, or one that it calls, uses an object whose changes cannot be seen.
    """
    text = [f"numba {numba.__version__} numpy {np.__version__} {_options_text(OPTIONS)}"]
    seen: list[FunctionType] = [function]
    for current in seen:  # grows while it is walked
        own, called = _description(current)
        text.append(own)
        seen += [callee for callee in dict.fromkeys(called) if callee not in seen]
    return hashlib.sha256("\n".join(text).encode()).hexdigest()


@cache
def _description(function: FunctionType) -> tuple[str, tuple[FunctionType, ...]]:
    """Text for a function's bytecode and the values that it uses, and the functions that it calls."""
    called: list[FunctionType] = []
    scope = dict(function.__globals__)
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        scope[name] = cell.cell_contents
    parts = [_code_text(function.__code__, function.__doc__)]
    parts += [_value_text("default", value, called) for value in function.__defaults__ or ()]
    for name, value in _references(function.__code__, scope):
        try:
            parts.append(f"{name}={_value_text(name, value, called)}")
        except TypeError as err:
            raise TypeError(f"kernel {function.__module__}.{function.__qualname__}: {err}") from None
    return "\n".join(parts), tuple(called)


def _code_text(code: CodeType, docstring: str | None = None) -> str:
    """Text for what code does: bytecode, names and constants, without its docstring and line numbers."""
    constants = [None if k == 0 and value == docstring else value for k, value in enumerate(code.co_consts)]
    texts = [_code_text(value) if isinstance(value, CodeType) else _sorted_text(value) for value in constants]
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    return repr((code.co_code, names, code.co_argcount, code.co_kwonlyargcount, code.co_flags, texts))


def _options_text(options: dict[str, Any]) -> str:
    """Text for a kernel's compiler options."""
    return str(sorted((key, _sorted_text(value)) for key, value in options.items()))


def _sorted_text(value: object) -> str:
    """Text for a constant; the order of a set of strings differs from process to process."""
    return str(sorted(map(repr, value))) if isinstance(value, set | frozenset) else repr(value)


def _references(code: CodeType, scope: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and values that code takes from its module and enclosing functions; ``module.name`` is followed."""
    name, value = "", None
    for step in dis.get_instructions(code):
        if name and isinstance(value, ModuleType) and step.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            name, value = f"{name}.{step.argval}", getattr(value, step.argval)
            continue
        if name:
            yield name, value
        name = ""
        if step.opname in ("LOAD_GLOBAL", "LOAD_DEREF") and step.argval in scope:
            name, value = str(step.argval), scope[step.argval]
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _references(constant, scope)


def _value_text(name: str, value: Any, called: list[FunctionType]) -> str:
    """Text for a value; functions are added to ``called``."""
    if isinstance(value, Dispatcher):
        called.append(value.py_func)
        return f"kernel {_options_text(value.targetoptions)}"
    if isinstance(value, tuple):
        items = ", ".join(_value_text(name, item, called) for item in value)
        return f"{getattr(value, '_fields', ())}({items})"
    if str(getattr(value, "__module__", None)).partition(".")[0] in LIBRARIES or isinstance(value, np.ufunc):
        return f"library {name}"
    if isinstance(value, FunctionType):
        called.append(value)
        return "function"
    return _constant_text(name, value)


def _constant_text(name: str, value: Any) -> str:
    """Text for a number, an array, a data type, an enumeration, or a class of named tuples."""
    if isinstance(value, _PLAIN):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, np.ndarray | np.generic):
        return f"{value.dtype.descr} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, np.dtype):
        return f"dtype {value.descr}"
    if isinstance(value, type) and hasattr(value, "_fields"):
        return f"{value.__qualname__} {value._fields}"
    if isinstance(value, type) and issubclass(value, Enum):
        return f"{value.__qualname__} {[(member.name, member.value) for member in value]}"
    raise TypeError(f"'{name}' is a {type(value).__name__}: its changes cannot be detected; use a constant")


def _bundles(types: Any) -> tuple[Any, ...]:
    """Classes and field names of the named tuples among argument types; Numba's own key has the fields' types alone."""
    if not isinstance(types, tuple | BaseTuple):
        return ()
    cls = getattr(types, "instance_class", None)
    own = () if cls is None else (cls.__qualname__, *cls._fields)
    return (own, *filter(None, map(_bundles, cast("tuple[Any, ...]", types))))


class _ByDigest:
    """Mixin of cache locations whose files are named by the digest of their function."""

    def __init__(self, py_func: FunctionType, py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[call-arg]
        self._digest = digest(py_func)

    def get_source_stamp(self) -> str:
        """Digest of the function."""
        return self._digest

    def get_disambiguator(self) -> str:
        """Part of the file name: code of another digest is never in the same file."""
        return self._digest[:16]


class _UserProvided(_ByDigest, caching.UserProvidedCacheLocator):
    pass


class _InTree(_ByDigest, caching.InTreeCacheLocator):
    pass


class _UserWide(_ByDigest, caching.UserWideCacheLocator):
    pass


class _Implementation(caching.CompileResultCacheImpl):
    _locator_classes = [_UserProvided, _InTree, _UserWide]  # noqa: RUF012 - declared so by Numba


class _KernelCache(caching.FunctionCache):
    _impl_class = _Implementation

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (*super()._index_key(sig, codegen), _bundles(sig))  # type: ignore[no-untyped-call]


class _LazyCache:
    """Cache of one kernel, opened at its first use: only then does every name that it refers to exist."""

    def __init__(self, function: FunctionType) -> None:
        self._function = function

    def __getattr__(self, name: str) -> Any:
        return getattr(self._opened, name)

    @cached_property
    def _opened(self) -> Any:
        try:
            return _KernelCache(self._function)  # type: ignore[no-untyped-call]
        except RuntimeError:  # no folder can be written to
            problem = "kernels are compiled at each start: no cache folder can be written to; set NUMBA_CACHE_DIR"
            warnings.warn(problem, RuntimeWarning, stacklevel=2)
            return caching.NullCache()
