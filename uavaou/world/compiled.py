"""Numba compiles the inner loops: a loop over scalars needs no array between two operations."""

import signal
import threading
from collections.abc import Callable
from functools import partial, wraps
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import IndexDataCacheFile

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers on its first call; cache the machine code on disk if possible.

    A compiled function calls only compiled functions of its own file: Numba's cache notices a change in the file of
    the function that Python calls, but not in the files of the functions that it calls. Floating-point rules are
    IEEE's: the numbers of a mission must not depend on its place in the batch.
    """
    return _compiled(function, fastmath=False)


def compiled_fast(function: F) -> F:
    """Compile like :func:`compiled`, and let LLVM reorder sums into vectors; infinities and NaNs keep their meaning."""
    return _compiled(function, fastmath={"reassoc", "contract", "nsz", "arcp"})


def uninterrupted(function: F) -> F:
    """Hold Ctrl-C and SIGTERM back until a compiled function has returned.

    For those that take a random generator: Numba runs Python to convert it, and the process dies if a signal raises an
    exception there.
    """

    @wraps(function)
    def call(*arguments: Any) -> Any:
        if threading.current_thread() is not threading.main_thread():  # Python handles signals there alone
            return function(*arguments)
        came: list[Any] = []
        handlers: dict[int, Any] = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            for number in handlers:
                if callable(handlers[number]):
                    signal.signal(number, lambda *signalled: came.append(signalled))
            result = function(*arguments)
        finally:
            for number, handler in handlers.items():
                if callable(handler):
                    signal.signal(number, handler)
        for number, frame in came[:1]:
            handlers[number](number, frame)
        return result

    return cast(F, call)


def _compiled(function: F, **options: Any) -> F:
    compiler = partial(numba.njit, nogil=True, error_model="numpy", **options)
    try:
        dispatcher = compiler(cache=True)(function)
        if hasattr(dispatcher, "_cache"):  # else NUMBA_DISABLE_JIT is set
            dispatcher._cache._cache_file.__class__ = _CheckedCacheFile
    except RuntimeError:  # neither the folder of the file nor the user's cache folder is writable
        dispatcher = compiler()(function)
    return cast(F, dispatcher)


class _CheckedCacheFile(IndexDataCacheFile):
    """Numba's cache of a function on disk; each entry also holds its key (the types) and the stamp of the source.

    Else two processes that compile for different types at once may choose one file, and a third may run wrong code.
    """

    def save(self, key: Any, data: Any) -> None:
        super().save(key, (key, self._source_stamp, data))  # type: ignore[no-untyped-call]

    def load(self, key: Any) -> Any:
        entry = super().load(key)  # type: ignore[no-untyped-call]
        return entry[2] if entry is not None and entry[:2] == (key, self._source_stamp) else None
