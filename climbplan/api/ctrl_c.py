"""Ctrl-C in a notebook, which must not get lost on its way out of a plan.

Python raises it wherever it happens to be, and CasADi drops what is raised while it looks at the
arguments of an operator: a statement is then built to its end as if nothing had been pressed. So it
is raised again and again until somebody handles it. The command line does the same for the whole
process (`climbplan.cli.interrupts`).
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_AGAIN = 0.1  # [s]


def being_handled() -> bool:
    """Whether the code that a signal interrupts is already handling an interrupt."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


@contextmanager
def ctrl_c_insists() -> Iterator[None]:
    """Ctrl-C ends what is within, whatever drops its exception.

    Nothing is changed in threads other than the main one, where a program has a handler of its own
    for Ctrl-C or for the alarm, and on systems without the alarm.
    """
    if not _is_ours_to_handle():
        yield
        return
    pressed = False

    def again(_: int, __: FrameType | None) -> None:
        if not being_handled():
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
    if pressed:  # and everything was over before it was raised again
        raise KeyboardInterrupt


def _is_ours_to_handle() -> bool:
    return (
        hasattr(signal, "setitimer")
        and threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        and signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
    )
