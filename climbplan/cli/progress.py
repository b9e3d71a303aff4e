"""Progress on standard error: a bar on terminals, a line every few seconds elsewhere."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, Self

from climbplan.cli.console import Invocation
from climbplan.progress import ProgressLines, ProgressMeter, format_seconds

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

DELAY = 1.0  # [s] a stage that ends sooner shows nothing
_LONG_COMPILATION = 1.0  # [s] from which its time is told at the end


class StageProgress:
    """Context whose `report(stage, fraction)` is the planners' progress callback.

    Searches and compilers in this context reach its meter. The bar is taken away at the end of a
    stage.
    """

    def __init__(self, session: Invocation) -> None:
        self._session = session
        self._enabled = session.shows_progress
        self._meter = ProgressMeter()
        self._context = ExitStack()
        self._lock = threading.RLock()
        self._timer: threading.Timer | None = None
        self._started = 0.0  # [s] monotonic, of the stage
        self._bar: tuple[Progress, TaskID] | None = None

    def __enter__(self) -> Self:
        self._context.enter_context(self._meter.observe())
        if self._session.writes_progress:
            lines = ProgressLines(self._meter, self._session.write_progress)
            self._context.enter_context(lines)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._lock:
            self._clear()
        self._context.close()
        if self._meter.compilation_seconds > _LONG_COMPILATION:
            count, seconds = self._meter.num_compiled, self._meter.compilation_seconds
            self._session.note(
                f"compiled {count} function{'s' * (count != 1)} in {format_seconds(seconds)}; "
                "the next run finds them on disk"
            )

    def report(self, stage: str, fraction: float) -> None:
        """Record that `stage` is done to `fraction` (0 to 1)."""
        self._session.stage = stage  # where the run ended, if it ends here
        with self._lock:
            if self._enabled and stage != self._meter.stage:
                self._clear()
                self._started = time.monotonic()
                self._timer = threading.Timer(DELAY, self._show)
                self._timer.daemon = True
                self._timer.start()
            self._meter.report(stage, fraction)
            if self._bar is not None:
                bar, task = self._bar
                # Without a fraction to show the bar pulses.
                total = 1.0 if fraction > 0 else None
                bar.update(task, completed=fraction, total=total)

    def _show(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn
        from rich.text import Text

        meter = self._meter

        class Line(ProgressColumn):
            """The meter's facts, read anew whenever the bar is drawn."""

            def render(self, task: object) -> Text:
                return Text(meter.describe_facts())

        with self._lock:
            if self._timer is not threading.current_thread():
                return  # the stage ended while rich was imported
            bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=24),
                Line(),
                console=Console(stderr=True),
                transient=True,
                get_time=time.monotonic,
            )
            task = bar.add_task(meter.stage, total=1.0 if meter.fraction > 0 else None)
            bar.update(task, completed=meter.fraction)
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
