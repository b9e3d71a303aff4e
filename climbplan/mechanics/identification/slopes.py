"""Stiffness matrices from force-displacement tests, the preload removed (chapter 4.3).

Joints are preloaded out of their backlash before a test. The published coefficient is the mean of
(F - F_preload) / (d - d_preload) over the steps, eq. (4.19). It carries the error of the one
preload reading into every step and doubles for a bad row. Here the slope is the median over all
pairs of steps (Theil and Sen). It depends on no particular row and tolerates more than a quarter
of outliers. The published mean is reported next to it.

Published methods, and equation and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.mechanics.identification.measurements import AXES, Matrix, Series

_NORMAL = 1.4826  # standard deviation of a normal distribution by its median absolute deviation
_OUTLIER = 5.0  # standard deviations of a row from the line


@dataclass(frozen=True)
class Slope:
    """The growth of forces along one loading."""

    series: Series
    stiffness: Array  # (a,) median slope [N/m]
    deviation: Array  # (a,) its standard deviation from the scatter of the rows [N/m]
    published: Array  # (a,) mean of the slopes from the preload, eq. (4.19) [N/m]
    bad_rows: tuple[int, ...]  # steps far off the line


def slope(series: Series) -> Slope:
    """Fit the stiffness column of one loading."""
    d, force = series.displacement, series.force
    first, second = np.triu_indices(len(d), 1)
    differ = np.abs(d[second] - d[first]) > 0
    first, second = first[differ], second[differ]
    rise = (force[second] - force[first]) / (d[second] - d[first])[:, None]
    steepness = np.median(rise, axis=0)
    residual = force - steepness * d[:, None]
    residual -= np.median(residual, axis=0)
    scatter = _NORMAL * np.median(np.abs(residual), axis=0)
    bad = (
        np.abs(residual) > _OUTLIER * np.maximum(scatter, 1e-9 + 0.01 * np.ptp(force, axis=0))
    ).any(1)
    spread = float(np.linalg.norm(d[~bad] - d[~bad].mean())) if (~bad).sum() > 1 else np.inf
    from_preload = d != d[0]
    published = (force[from_preload] - force[0]) / (d[from_preload] - d[0])[:, None]
    return Slope(
        series, steepness, scatter / spread, published.mean(axis=0), tuple(np.flatnonzero(bad))
    )


@dataclass(frozen=True)
class Reduced:
    """Matrices from tests, with their defects."""

    matrices: tuple[Matrix, ...]
    slopes: tuple[Slope, ...]
    asymmetry: Array  # (m,) |K - K^T| / |K|; a limb's own is zero
    skipped: tuple[str, ...]


def matrices_from(series: Sequence[Series], axes: tuple[int, ...]) -> Reduced:
    """Compute one matrix for each test that was loaded along every measured axis.

    Column j of a matrix holds the forces by a displacement along axis j, eq. (4.20).
    """
    by_test: dict[str, dict[int, Slope]] = {}
    slopes = [slope(column) for column in series]
    for column in slopes:
        by_test.setdefault(column.series.test, {})[column.series.axis] = column
    matrices, asymmetry, skipped = [], [], []
    for test, columns in by_test.items():
        if len(columns) < len(axes):
            missing = ", ".join(AXES[axes[j]] for j in range(len(axes)) if j not in columns)
            skipped.append(f"test {test}: not loaded along {missing}")
            continue
        in_order = [columns[j] for j in range(len(axes))]
        stiffness = np.stack([column.stiffness for column in in_order], axis=1)
        deviation = np.stack([column.deviation for column in in_order], axis=1)
        # The sensor may count forces of the limb on the fixture or the reverse: a limb resists, so
        # the diagonal is positive.
        if np.trace(stiffness) < 0:
            stiffness = -stiffness
        head = in_order[0].series
        matrices.append(Matrix(test, head.posture, head.gain, stiffness, deviation, head.line))
        skew = np.linalg.norm(stiffness - stiffness.T) / np.linalg.norm(stiffness)
        asymmetry.append(float(skew))
    return Reduced(tuple(matrices), tuple(slopes), np.array(asymmetry), tuple(skipped))
