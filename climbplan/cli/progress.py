"""A progress bar for stages that take over a second, on terminals only."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from climbplan.cli.console import Invocation

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

DELAY = 1.0  # [s] a stage that ends sooner shows nothing


class StageProgress:
    """Context whose `report(stage, fraction)` is the planners' progress callback."""

    def __init__(self, session: Invocation) -> None:
        self._session = session
        self._enabled = session.shows_progress
        self._lock = threading.RLock()
        self._stage = ""
        self._started = 0.0  # [s] monotonic
        self._fraction = 0.0
        self._timer: threading.Timer | None = None
        self._bar: tuple[Progress, TaskID] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._lock:
            self._clear()

    def report(self, stage: str, fraction: float) -> None:
        """Tell that `stage` is done to `fraction` (0 to 1)."""
        self._session.stage = stage  # where the run ended, if it ends here
        if not self._enabled:
            return
        with self._lock:
            if stage != self._stage:
                self._clear()
                self._stage = stage
                self._started = time.monotonic()
                self._timer = threading.Timer(DELAY, self._show)
                self._timer.daemon = True
                self._timer.start()
            self._fraction = fraction
            if self._bar is not None:
                bar, task = self._bar
                bar.update(task, completed=fraction)

    def _show(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        with self._lock:
            if self._timer is not threading.current_thread():
                return  # the stage ended while rich was imported
            bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TimeElapsedColumn(),
                console=Console(stderr=True),
                transient=True,
                get_time=time.monotonic,
            )
            # Without a fraction to show the bar pulses.
            total = 1.0 if self._fraction > 0 else None
            task = bar.add_task(self._stage, total=total)
            bar.update(task, completed=self._fraction)
            bar.tasks[0].start_time = self._started
            bar.start()
            self._bar = (bar, task)

    def _clear(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._bar is not None:
            self._bar[0].stop()
            self._bar = None
