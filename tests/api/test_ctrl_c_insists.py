"""Ctrl-C ends what the public door runs, whatever drops its exception."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator

import pytest

from climbplan.api.ctrl_c import ctrl_c_insists


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    """Ctrl-C as in a notebook."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def press_and_drop(times: int = 1) -> None:
    """Ctrl-C, and a library that forgets what is raised."""
    for _ in range(times):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.05)
        except KeyboardInterrupt:
            pass


def assert_as_before() -> None:
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_what_is_dropped_is_raised_again() -> None:
    @ctrl_c_insists()
    def work() -> None:
        press_and_drop()
        time.sleep(20.0)

    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        work()
    assert time.monotonic() - begin < 10.0
    assert_as_before()


def test_so_it_is_after_what_was_over_by_then() -> None:
    finished = []

    @ctrl_c_insists()
    def work() -> None:
        press_and_drop()
        finished.append(True)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert finished
    assert_as_before()


def test_clearing_away_is_not_interrupted_again() -> None:
    cleared = []

    @ctrl_c_insists()
    def work() -> None:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5.0)
        finally:
            time.sleep(0.4)  # four alarms
            cleared.append(True)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert cleared
    assert_as_before()


def test_without_ctrl_c_nothing_is_raised() -> None:
    @ctrl_c_insists()
    def answer() -> int:
        return 42

    assert answer() == 42
    assert_as_before()


def test_handlers_of_others_are_left_alone() -> None:
    pressed: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: pressed.append(number))
    with ctrl_c_insists():
        press_and_drop()
    assert pressed == [signal.SIGINT]
    found = []

    def aside() -> None:
        with ctrl_c_insists():
            found.append(signal.getsignal(signal.SIGALRM))

    signal.signal(signal.SIGINT, signal.default_int_handler)
    thread = threading.Thread(target=aside)
    thread.start()
    thread.join()
    assert found == [signal.SIG_DFL]
