"""A line where functions are compiled: on a machine's first run that takes longer than the plan."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from climbplan.cli.console import Session

_WORD = "compiling functions, which a machine does once; this takes up to half a minute"


@contextmanager
def compiling_told(session: Session) -> Iterator[None]:
    """Note on standard error, once, if Numba compiles anything within; loading its cache is none.

    For commands that use compiled functions, once they import them.
    """
    from numba.core import event

    class Teller(event.Listener):  # type: ignore[misc]  # Numba has no types
        """Numba's event comes as a function is compiled, and not where its cache serves."""

        told = False

        def on_start(self, event: object) -> None:
            if not self.told:
                self.told = True
                session.note(_WORD)

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Teller()):
        yield
