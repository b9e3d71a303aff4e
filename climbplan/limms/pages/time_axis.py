"""Axes of time that give room to what the box does: long driving before is pressed together."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes

from climbplan.arrays import Array
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.reports import palette

_MOVED = 1e-3  # [m] of the box
_BEFORE = 1.0  # [s] before it moves that are drawn in full
_LONG = 0.5  # share of the motion from which what comes before is pressed together
_PRESSED = 0.2  # share of the axis that it gets then


class TimeScale:
    """Where times of a plan stand on an axis from 0 to 1."""

    def __init__(self, plan: LimmsPlan) -> None:
        time, box = plan.motion.time, plan.motion.box_position
        start, end = float(time[0]), float(time[-1])
        self.start, self.end, self.begin = start, end, start  # begin: of what is drawn in full [s]
        moved = np.flatnonzero(np.linalg.norm(box - box[0], axis=-1).max(axis=1) > _MOVED)
        begin = float(time[int(moved[0])]) - _BEFORE if len(moved) else start
        if begin - start > _LONG * (end - start):
            self.begin = begin
            self._time = np.array([start, begin, end])
            self._place = np.array([0.0, _PRESSED, 1.0])
        else:
            self._time, self._place = np.array([start, end]), np.array([0.0, 1.0])

    @property
    def label(self) -> str:
        """What stands below the axis."""
        pressed = self.begin - self.start
        return f"time [s]; the first {pressed:.1f} s pressed together" if pressed else "time [s]"

    def place(self, time: Array) -> Array:
        """Of times [s]; straight on beyond both ends."""
        return _through(time, self._time, self._place)

    def apply(self, panels: Iterable[Axes]) -> None:
        """Scale the time axes of panels, and mark where the pressed part ends."""
        if self.begin == self.start:
            return
        ticks = [self.start, *np.linspace(self.begin, self.end, 5)]
        for panel in panels:
            panel.set_xscale("function", functions=(self.place, self._time_at))
            panel.set_xlim(self.start, self.end)
            panel.set_xticks(ticks, [f"{time:.1f}" for time in ticks])
            panel.axvline(self.begin, color=palette.MUTED, linewidth=1.0, linestyle=(0, (4, 3)))

    def _time_at(self, place: Array) -> Array:
        return _through(place, self._place, self._time)


def _through(x: Array, known: Array, values: Array) -> Array:
    """Values at x, piecewise linear through those at known places and on beyond them."""
    x = np.asarray(x, float)
    piece = np.clip(np.searchsorted(known, x, side="right") - 1, 0, len(known) - 2)
    slope = np.diff(values) / np.diff(known)
    found: Array = values[piece] + slope[piece] * (x - known[piece])
    return found
