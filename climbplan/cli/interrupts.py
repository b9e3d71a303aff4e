"""Ctrl-C and SIGTERM as exceptions that do not get lost on their way to the command line.

A signal handler raises wherever Python happens to be, and some libraries drop what is raised there:
CasADi forgets any exception while it looks at the arguments of an operator, and turns one in a
callback into a failed solve. An interrupt is therefore raised again and again until somebody
handles it. Handling it, clearing away included, is not interrupted itself.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import NoReturn

from climbplan.api.ctrl_c import is_interrupt_handled

_AGAIN = 0.1  # [s]
_received: list[int] = []  # the first signal, from then on the only one


class Terminated(KeyboardInterrupt):
    """The process was asked to end: what is half done is cleared away as after Ctrl-C."""


def raise_on_signals() -> None:
    """Take over SIGTERM, and Ctrl-C where it is not ignored, for the rest of the process."""
    sys.unraisablehook = _without_interrupts
    signal.signal(signal.SIGTERM, _interrupt)
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _interrupt)


def _without_interrupts(dropped: sys.UnraisableHookArgs) -> None:
    """Tell of errors that Python drops, as in callbacks of weak references; signals come again."""
    if not isinstance(dropped.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(dropped)


def interrupt_handled() -> int | None:
    """Raise it no more. The signal that came, if any, whatever became of its exception."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    return _received[0] if _received else None


def _interrupt(number: int, _: FrameType | None) -> NoReturn:
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)  # once: clearing away is not to be cut short
    _received.append(number)
    signal.signal(signal.SIGALRM, _once_more)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
    raise _exception()


def _once_more(_: int, frame: FrameType | None) -> None:
    if not is_interrupt_handled():
        raise _exception()


def _exception() -> KeyboardInterrupt:
    return Terminated() if _received[0] == signal.SIGTERM else KeyboardInterrupt()
