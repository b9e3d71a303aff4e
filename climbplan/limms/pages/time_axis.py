"""Time axes that emphasise motions of boxes: long driving before them is compressed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes

from climbplan.arrays import Array
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.reports import palette

_MOTION_TOLERANCE = 1e-3  # [m] of the box
_LEAD_TIME = 1.0  # [s] before the motion at full scale
_MAX_FRACTION = 0.5  # fraction of the plan above which the time before is compressed
_COMPRESSED_FRACTION = 0.2  # fraction of the axis for compressed time


class TimeScale:
    """The positions of times of a plan on an axis from 0 to 1."""

    def __init__(self, plan: LimmsPlan) -> None:
        time, box = plan.motion.time, plan.motion.box_position
        start, end = float(time[0]), float(time[-1])
        self.start, self.end, self.motion_start = (
            start,
            end,
            start,
        )  # motion_start: where full scale begins [s]
        moving = np.flatnonzero(
            np.linalg.norm(box - box[0], axis=-1).max(axis=1) > _MOTION_TOLERANCE
        )
        motion_start = float(time[int(moving[0])]) - _LEAD_TIME if len(moving) else start
        if motion_start - start > _MAX_FRACTION * (end - start):
            self.motion_start = motion_start
            self._time = np.array([start, motion_start, end])
            self._positions = np.array([0.0, _COMPRESSED_FRACTION, 1.0])
        else:
            self._time, self._positions = np.array([start, end]), np.array([0.0, 1.0])

    @property
    def label(self) -> str:
        """The label of the axis."""
        compressed = self.motion_start - self.start
        return (
            f"time [s]; the first {compressed:.1f} s pressed together" if compressed else "time [s]"
        )

    def map_times(self, time: Array) -> Array:
        """Return positions of times [s], extrapolated beyond both ends."""
        return _interpolate(time, self._time, self._positions)

    def apply(self, panels: Iterable[Axes]) -> None:
        """Scale the time axes of panels, and mark the end of the compressed part."""
        if self.motion_start == self.start:
            return
        ticks = [self.start, *np.linspace(self.motion_start, self.end, 5)]
        for panel in panels:
            panel.set_xscale("function", functions=(self.map_times, self._time_at))
            panel.set_xlim(self.start, self.end)
            panel.set_xticks(ticks, [f"{time:.1f}" for time in ticks])
            panel.axvline(
                self.motion_start, color=palette.MUTED, linewidth=1.0, linestyle=(0, (4, 3))
            )

    def _time_at(self, place: Array) -> Array:
        """Return the times at positions."""
        return _interpolate(place, self._positions, self._time)


def _interpolate(x: Array, positions: Array, values: Array) -> Array:
    """Return values at x, piecewise linear with extrapolation."""
    x = np.asarray(x, float)
    piece = np.clip(np.searchsorted(positions, x, side="right") - 1, 0, len(positions) - 2)
    slope = np.diff(values) / np.diff(positions)
    interpolated: Array = values[piece] + slope[piece] * (x - positions[piece])
    return interpolated
