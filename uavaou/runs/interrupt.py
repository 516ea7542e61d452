"""Ctrl-C and SIGTERM while training: the first asks for a last checkpoint, the second gets its way at once."""

import os
import signal
import threading
from types import FrameType
from typing import Any, Self

_ASKED = b"\nuavaou: finishing the present update and saving; once more leaves at once\n"
_repeats_count = True


def ignore_repeats() -> None:
    """From now on, a second signal means nothing in this process.

    For worker processes: who stops a whole group of processes tells them, and their parent tells them again.
    """
    global _repeats_count
    _repeats_count = False


class Terminated(KeyboardInterrupt):
    """SIGTERM came, which is answered as Ctrl-C is."""


def interrupt_at_sigterm(repeats: signal.Handlers = signal.SIG_IGN) -> None:
    """From now on, the first SIGTERM raises :class:`Terminated` in this process; the next have the handler ``repeats``.

    A process outside of whose main thread this is called, or that ignores SIGTERM, is left as it is.
    """

    def leave(*_: object) -> None:
        signal.signal(signal.SIGTERM, repeats)
        raise Terminated

    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) != signal.SIG_IGN:
        signal.signal(signal.SIGTERM, leave)


def exit_code(error: BaseException) -> int:
    """The exit code of a command that an interrupt ended, as shells report it: 143 after SIGTERM, else 130."""
    causes = (error, error.__cause__, error.__context__)
    return 128 + (signal.SIGTERM if any(isinstance(one, Terminated) for one in causes) else signal.SIGINT)


def was_interrupt(error: SystemError) -> bool:
    """Whether an error is a KeyboardInterrupt that came while a compiled function was being called.

    Numba's dispatcher hands back a result then, with the exception still set, which Python reports as its own error.
    """
    return isinstance(error.__cause__, KeyboardInterrupt)


class Interrupted(Exception):  # noqa: N818 - nothing went wrong
    """The training stopped because it was asked to, after a checkpoint."""


class Interrupts:
    """Notes the first SIGINT or SIGTERM in ``received`` and leaves the next to whoever had it before.

    A signal that is ignored stays so. Outside of the main thread nothing is noted: Python allows no handlers there.

    Args:
        quiet: say nothing.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.received: signal.Signals | None = None
        self._quiet = quiet
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                if signal.getsignal(number) not in (signal.SIG_IGN, None):
                    self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.received = signal.Signals(number)
        if _repeats_count:
            self._restore()
        if not self._quiet:
            os.write(2, _ASKED)  # print is not allowed to be interrupted by itself

    def _restore(self) -> None:
        while self._before:
            signal.signal(*self._before.popitem())
