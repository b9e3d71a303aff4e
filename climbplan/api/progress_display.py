"""Progress of runs that Python starts: a callback, lines on standard error, a bar in notebooks."""

from __future__ import annotations

import html
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from climbplan.errors import UsageError
from climbplan.progress import Progress, ProgressLines, ProgressMeter, format_seconds

_NOTEBOOK_INTERVAL = 0.5  # [s] between updates of the bar


@contextmanager
def show_progress(progress: Progress | bool | None) -> Iterator[Progress]:
    """Show the progress of a run, and yield the callback that the run reports to.

    Args:
        progress: A callback of stage and fraction, which is called and shows nothing else; True
            shows a bar in notebooks and a line every five seconds on standard error elsewhere;
            False shows nothing; None shows the bar in notebooks only.

    Raises:
        UsageError: The environment sets no time between lines that is a positive number.
    """
    meter = ProgressMeter()
    display = find_notebook_display() if progress is None or progress is True else None
    with meter.observe():
        if callable(progress):
            yield _report_to_both(meter, progress)
        elif display is not None:
            with _show_bar(meter, display):
                yield meter.report
        elif progress:
            with _create_lines(meter):
                yield meter.report
        else:
            yield meter.report


def _create_lines(meter: ProgressMeter) -> ProgressLines:
    """Return the context that writes lines of a meter on standard error."""
    try:
        return ProgressLines(meter, lambda line: print(line, file=sys.stderr, flush=True))
    except ValueError as error:
        raise UsageError(str(error)) from None


def _report_to_both(meter: ProgressMeter, callback: Progress) -> Progress:
    def report(stage: str, fraction: float) -> None:
        meter.report(stage, fraction)
        callback(stage, fraction)

    return report


def find_notebook_display() -> Callable[..., Any] | None:
    """Return the display function of a notebook's kernel; None outside notebooks."""
    if "IPython" not in sys.modules:
        return None
    from IPython import display, get_ipython

    shell = get_ipython()
    return display.display if hasattr(shell, "kernel") else None


class _Bar:
    """A bar of a meter: HTML for notebooks, text elsewhere."""

    def __init__(self, meter: ProgressMeter, ending: str = "") -> None:
        self.meter, self.ending = meter, ending

    def __repr__(self) -> str:
        return self.ending or self.meter.describe()

    def _repr_html_(self) -> str:
        if self.ending:
            return f"<small>{html.escape(self.ending)}</small>"
        fraction = self.meter.fraction
        value = f' value="{fraction:.3f}"' if fraction > 0 else ""  # without one it pulses
        stage, facts = html.escape(self.meter.stage), html.escape(self.meter.describe_facts())
        return f'<progress max="1"{value}></progress> <b>{stage}</b> <small>{facts}</small>'


@contextmanager
def _show_bar(meter: ProgressMeter, display: Callable[..., Any]) -> Iterator[None]:
    """Show a bar in a notebook, and at the end one line about the run."""
    handle = display(_Bar(meter), display_id=True)
    is_complete = False
    try:
        with ProgressLines(meter, lambda line: handle.update(_Bar(meter)), _NOTEBOOK_INTERVAL):
            yield
        is_complete = True
    finally:
        outcome = "done in" if is_complete else f"stopped in stage {meter.stage!r} after"
        handle.update(_Bar(meter, f"{outcome} {format_seconds(meter.elapsed)}"))
