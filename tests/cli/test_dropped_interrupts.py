"""A signal that arrives where Python drops errors is not told as one of them."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import os, signal, weakref
from climbplan.cli.interrupts import interrupt_handled, raise_on_signals

class Thing:
    pass

def when_gone(_):
    os.kill(os.getpid(), signal.SIGINT)

raise_on_signals()
thing = Thing()
watch = weakref.ref(thing, when_gone)
try:
    del thing
    while True:
        signal.pause()
except KeyboardInterrupt:
    print("interrupted by", interrupt_handled())
"""


def test_an_interrupt_in_a_weak_reference_comes_again_and_prints_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "interrupted by 2\n"
    assert done.stderr == ""
