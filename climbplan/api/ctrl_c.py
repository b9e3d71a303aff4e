"""Deliver Ctrl-C reliably in notebooks.

Python raises KeyboardInterrupt wherever it happens to be, and CasADi drops exceptions that are
raised while it inspects the arguments of an operator. The interrupt would be lost there, so it is
raised repeatedly until it is handled. The command line does the same for the whole process
(`climbplan.cli.interrupts`).
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_AGAIN = 0.1  # [s]


def is_interrupt_handled() -> bool:
    """Return whether the code that a signal interrupts is already handling an interrupt."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


@contextmanager
def ctrl_c_insists() -> Iterator[None]:
    """Make Ctrl-C end the block, even if a library drops the exception.

    Nothing is changed in threads other than the main one, in programs with their own handler for
    Ctrl-C or for the alarm signal, and on systems without that signal.
    """
    if not _is_ours_to_handle():
        yield
        return
    pressed = False

    def again(_: int, __: FrameType | None) -> None:
        if not is_interrupt_handled():
            raise KeyboardInterrupt

    def press(_: int, __: FrameType | None) -> None:
        nonlocal pressed
        pressed = True
        signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
        raise KeyboardInterrupt

    signal.signal(signal.SIGALRM, again)
    signal.signal(signal.SIGINT, press)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
    if pressed:  # the block ended before the interrupt was raised again
        raise KeyboardInterrupt


def _is_ours_to_handle() -> bool:
    return (
        hasattr(signal, "setitimer")
        and threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        and signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
    )
