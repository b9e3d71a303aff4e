"""Progress of a dataset run: rate, share of rows with an answer, time left."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from climbplan.cli.console import Invocation
from climbplan.progress import LINE_INTERVAL

if TYPE_CHECKING:
    from climbplan.datasets.run import Count


class DatasetProgress:
    """Context whose `report` is the run's callback: a bar on terminals, lines elsewhere."""

    def __init__(self, session: Invocation) -> None:
        self._session = session
        self._enabled = session.shows_progress
        self._line_time = time.monotonic()  # [s] of the last line
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the bar away, before lines are printed."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
            self._enabled = False

    def report(self, count: Count) -> None:
        """Show how far the run is."""
        if self._session.writes_progress and time.monotonic() - self._line_time > LINE_INTERVAL:
            self._line_time = time.monotonic()
            line = f"{count.done} of {count.total} rows, {figures_of(count)}"
            self._session.write_progress(f"{'rows':<10}{line}")
        if not self._enabled:
            return
        if self._bar is None:
            self._start(count.total)
        self._bar.update(self._task, completed=count.done, figures=figures_of(count))

    def _start(self, total: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        self._bar = Progress(
            TextColumn("rows"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            console=Console(stderr=True),
            transient=True,
        )
        self._task = self._bar.add_task("rows", total=total, figures="")
        self._bar.start()


def figures_of(count: Count) -> str:
    """ "52.1 rows/s, 99.8 % answered, 0:03:10 left"."""
    if not count.new:
        return "starting"
    answered_percent = 100 * count.answered / count.done
    seconds = round(count.left)
    left = f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
    return f"{count.rate:.3g} rows/s, {answered_percent:.1f} % answered, {left} left"
