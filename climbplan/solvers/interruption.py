"""Ctrl-C during a call into CasADi, which would swallow it and return as if it had been stopped."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interruptible(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` on Ctrl-C, and raise KeyboardInterrupt once the solver has returned.

    Nothing is changed where Ctrl-C is ignored, and in threads other than the main one, which
    signals do not reach.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    interrupted = False

    def remember(_: int, __: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        stop()

    signal.signal(signal.SIGINT, remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if interrupted:
        raise KeyboardInterrupt
