"""Stiffness matrices from force-displacement tests, the preload removed (chapter 4.3).

Joints are preloaded out of their backlash before a test. The published coefficient is the mean of
(F - F_preload) / (d - d_preload) over the steps, eq. (4.19); it carries the error of the one
preload reading into every step and doubles for a bad row. Here the slope is the median over all
pairs of steps (Theil and Sen), which needs no particular row to be right and stands up to more
than a quarter of bad ones; the published mean is reported beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.mechanics.identification.measurements import AXES, Matrix, Series

_NORMAL = 1.4826  # standard deviation of a normal distribution by its median absolute deviation
_BAD = 5.0  # standard deviations from the line beyond which a row is called bad


@dataclass(frozen=True)
class Slope:
    """How forces grow along one loading."""

    series: Series
    stiffness: Array  # (a,) median slope [N/m]
    deviation: Array  # (a,) its standard deviation from the scatter of the rows [N/m]
    published: Array  # (a,) mean of the slopes from the preload, eq. (4.19) [N/m]
    bad_rows: tuple[int, ...]  # steps far off the line


def slope(series: Series) -> Slope:
    """The stiffness column of one loading."""
    d, force = series.displacement, series.force
    first, second = np.triu_indices(len(d), 1)
    apart = np.abs(d[second] - d[first]) > 0
    first, second = first[apart], second[apart]
    rise = (force[second] - force[first]) / (d[second] - d[first])[:, None]
    steepness = np.median(rise, axis=0)
    off = force - steepness * d[:, None]
    off -= np.median(off, axis=0)
    scatter = _NORMAL * np.median(np.abs(off), axis=0)
    bad = (np.abs(off) > _BAD * np.maximum(scatter, 1e-9 + 0.01 * np.ptp(force, axis=0))).any(1)
    spread = float(np.linalg.norm(d[~bad] - d[~bad].mean())) if (~bad).sum() > 1 else np.inf
    from_preload = d != d[0]
    published = (force[from_preload] - force[0]) / (d[from_preload] - d[0])[:, None]
    return Slope(
        series, steepness, scatter / spread, published.mean(axis=0), tuple(np.flatnonzero(bad))
    )


@dataclass(frozen=True)
class Reduced:
    """Matrices from tests, with what was found wrong on the way."""

    matrices: tuple[Matrix, ...]
    slopes: tuple[Slope, ...]
    asymmetry: Array  # (m,) |K - K^T| / |K|; a limb's own is zero
    skipped: tuple[str, ...]


def matrices_from(series: Sequence[Series], axes: tuple[int, ...]) -> Reduced:
    """One matrix for each test that was loaded along every measured axis.

    Column j of a matrix holds the forces by a displacement along axis j, eq. (4.20).
    """
    found: dict[str, dict[int, Slope]] = {}
    slopes = [slope(one) for one in series]
    for one in slopes:
        found.setdefault(one.series.test, {})[one.series.axis] = one
    matrices, asymmetry, skipped = [], [], []
    for test, columns in found.items():
        if len(columns) < len(axes):
            missing = ", ".join(AXES[axes[j]] for j in range(len(axes)) if j not in columns)
            skipped.append(f"test {test}: not loaded along {missing}")
            continue
        ordered = [columns[j] for j in range(len(axes))]
        stiffness = np.stack([one.stiffness for one in ordered], axis=1)
        deviation = np.stack([one.deviation for one in ordered], axis=1)
        # The sensor may count forces as the limb's on the fixture or the other way round: a limb
        # resists, so the diagonal is positive.
        if np.trace(stiffness) < 0:
            stiffness = -stiffness
        head = ordered[0].series
        matrices.append(Matrix(test, head.posture, head.gain, stiffness, deviation, head.line))
        skew = np.linalg.norm(stiffness - stiffness.T) / np.linalg.norm(stiffness)
        asymmetry.append(float(skew))
    return Reduced(tuple(matrices), tuple(slopes), np.array(asymmetry), tuple(skipped))
