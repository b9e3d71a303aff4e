"""What lies beneath the ways of swinging toes, compiled: what they have to clear."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.kernels.compiling import compiled

_NOTHING = -1e30
_TOUCHES = 1e-9  # [m], and of a way: ground that a way begins or ends at counts, whatever rounding


@compiled
def highest_beneath(
    one: Array,
    other: Array,
    lower: Array,
    upper: Array,
    sides: Array,
    height: Array,
    slope: Array,
    inner: Array,
) -> float:
    """The highest ground beneath a level way from one point (2,) straight to another [m].

    Far below everything if there is none. The ground is as of `Ground`.
    """
    highest = _NOTHING
    for s in range(height.shape[0]):
        begin, end = 0.0, 1.0
        for k in range(2):
            step = other[k] - one[k]
            for sign, bound in ((-1.0, -lower[s, k]), (1.0, upper[s, k])):
                room = bound - sign * one[k]
                rate = sign * step
                if abs(rate) < 1e-12:
                    if room < -_TOUCHES:
                        end = -1.0
                elif rate > 0.0:
                    end = min(end, room / rate)
                else:
                    begin = max(begin, room / rate)
        for c in range(sides.shape[1]):
            a, b = sides[s, c, 0], sides[s, c, 1]
            room = sides[s, c, 2] - a * one[0] - b * one[1]
            rate = a * (other[0] - one[0]) + b * (other[1] - one[1])
            if abs(rate) < 1e-12:
                if room < -_TOUCHES:
                    end = -1.0
            elif rate > 0.0:
                end = min(end, room / rate)
            else:
                begin = max(begin, room / rate)
        if begin > end + _TOUCHES:
            continue
        for share in (begin, end):
            level = height[s]
            for k in range(2):
                level += slope[s, k] * (one[k] + share * (other[k] - one[k]) - inner[s, k])
            highest = max(highest, level)
    return highest


@compiled
def swing_heights(
    toes: Array,
    contact: BoolArray,
    region: IntArray,
    lower: Array,
    upper: Array,
    sides: Array,
    height: Array,
    slope: Array,
    inner: Array,
) -> Array:
    """Ground (N + 1, L) that swinging toes (N + 1, L, 3) have to clear at each knot [m].

    The highest beneath their ways from the knot before and to the next, and where they come down:
    up where a toe stood, level across, down where it will stand. region (N + 1, L): where they
    stand, or will. Of standing toes their own height.
    """
    knots, legs = contact.shape
    clear = np.empty((knots, legs))
    for leg in range(legs):
        for n in range(knots):
            clear[n, leg] = toes[n, leg, 2]
            if contact[n, leg] or n == 0:
                continue
            lands = n
            while lands < knots and not contact[lands, leg]:
                lands += 1
            if lands < knots:
                needed = toes[lands, leg, 2]
            else:  # beyond the horizon: the region that it is on the way to
                s = region[knots - 1, leg]
                needed = height[s]
                for k in range(2):
                    here = min(max(toes[n, leg, k], lower[s, k]), upper[s, k])
                    needed += slope[s, k] * (here - inner[s, k])
            for m in (n - 1, n + 1):
                if m < knots:
                    beneath = highest_beneath(
                        toes[n, leg, :2], toes[m, leg, :2],
                        lower, upper, sides, height, slope, inner,
                    )  # fmt: skip
                    needed = max(needed, beneath)
            clear[n, leg] = needed
    return clear
