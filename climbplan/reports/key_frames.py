"""The fewest samples of a motion that play it back faithfully."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray


def select_key_frames(time: Array, values: Array, forced: BoolArray, tolerance: float) -> IntArray:
    """Return indices of samples between which linear interpolation errs by at most `tolerance`.

    Spans are split at their worst sample until none is off (Ramer, Douglas, Peucker).

    Args:
        time: (T,) [s].
        values: (T, D) of one unit.
        forced: (T,) bool, samples that are kept in any case.
        tolerance: Largest error of a component, in the unit of the values.
    """
    keep = forced.copy()
    keep[[0, -1]] = True
    forced_samples = np.flatnonzero(keep)
    open_spans = list(pairwise(forced_samples))
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        inside = slice(first + 1, last)
        fraction = (time[inside] - time[first]) / (time[last] - time[first])
        straight = values[first] + fraction[:, None] * (values[last] - values[first])
        error = np.abs(values[inside] - straight).max(axis=1)
        worst = int(np.argmax(error))
        if error[worst] > tolerance:
            split = first + 1 + worst
            keep[split] = True
            open_spans += [(first, split), (split, last)]
    return np.flatnonzero(keep)
