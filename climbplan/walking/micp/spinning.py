"""What angular velocities do: rates of angles and gyroscopic moments, by envelopes of products.

Within a tube of 20 degrees and 3 rad/s a rate linear about the middle is off by 2 rad/s, and
a gyroscopic moment by several times what legs exert. Both are products of what the program has: of
angular velocities with sines of angles, and of two angular velocities about principal axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.frame import FINE, LEAST, Frame
from climbplan.walking.micp.model import Lin, total

Function = Literal["secant", "tangent"]
_GRID = 201  # points of a range
_PAD = 1e-12  # of rounding


@dataclass(frozen=True)
class Straight:
    """A function of x is middle + slope (x - x_middle) within `off`."""

    middle: float
    slope: float
    off: float


def sine(half: float) -> tuple[float, float]:
    """A slope of sin x for |x| <= half <= pi / 2, and how far the line is off at most."""
    if half < 1e-9:
        return 1.0, half
    slope = max(1.0 - half**2 / 8.0, 0.0)  # off alike between and at the ends, to fourth order
    # sin x - slope x rises up to where the cosine is the slope, and falls from there.
    top = min(float(np.arccos(slope)), half)
    return slope, max(abs(float(np.sin(x)) - slope * x) for x in (top, half)) + _PAD


def straight(name: Function, middle: float, half: float) -> Straight:
    """The line through both ends, moved halfway to what lies between; |middle| + half < pi / 2."""
    x = np.linspace(middle - half, middle + half, _GRID)
    values = 1.0 / np.cos(x) if name == "secant" else np.tan(x)
    if half < 1e-9:
        return Straight(float(values[0]), 0.0, float(np.ptp(values)) + _PAD)
    steepest = abs(middle) + half
    sec, tan = 1.0 / np.cos(steepest), np.tan(steepest)
    bent = sec * (tan**2 + sec**2) if name == "secant" else 2.0 * sec**2 * tan
    slope = (values[-1] - values[0]) / (2.0 * half)
    left = values - slope * (x - middle)
    off = 0.5 * np.ptp(left) + (x[1] - x[0]) ** 2 * bent / 8.0  # between points of the grid
    return Straight(float(0.5 * (left.min() + left.max())), float(slope), float(off) + _PAD)


_WHOLE = Lin(constant=1.0)  # a share of products that are there in any case
_AHEAD, _LAST = (1, 2, 0), (2, 0, 1)


class Spinning(Frame):
    """Rows of what turns at each knot."""

    def turn(self, n: int) -> list[Lin]:
        """The small turn (3,) from the middle of the tube, about the body's axes there."""
        middle, axes = self.tube.angles[n], self.turns[n].axes
        off = [self.angles[n][j] - float(middle[j]) for j in range(3)]
        return [total(off[j] * float(axes[i, j]) for j in range(3)) for i in range(3)]

    def turn_about(self, n: int) -> tuple[list[Lin], Array]:
        """That turn about principal axes there (3,), and the largest of it (3,)."""
        axes, t = self.turns[n].principal, self.turns[n]
        turn = self.turn(n)
        found = [total(turn[j] * float(axes[j, k]) for j in range(3)) for k in range(3)]
        return found, np.abs(axes.T @ t.axes) @ self.tube.angles_half[n]

    def seen(self, name: str, n: int, middle: list[Lin], low: Array, high: Array) -> list[Lin]:
        """r' - w x r', which is R^T r of a vector r but for what is of second order.

        middle: r', which is r seen from the middle of the tube, within low and high (3,); w is the
        small turn from there.
        """
        t, turn = self.turns[n], self.turn(n)
        found = []
        for k in range(3):
            i, j = _AHEAD[k], _LAST[k]
            across = self.envelope(name, turn[i], t.turn_half[i], middle[j], low[j], high[j])
            back = self.envelope(name, turn[j], t.turn_half[j], middle[i], low[i], high[i])
            found.append(middle[k] - across + back)
        return found

    def envelope(self, name: str, x: Lin, half: float, y: Lin, low: float, high: float) -> Lin:
        """x y with |x| <= half and y in [low, high], by its four McCormick rows."""
        if half < 1e-9:
            return Lin()
        if high - low < 1e-12:
            return x * low
        if (off := 0.5 * half * (high - low)) <= FINE:
            return x * (0.5 * (low + high)) + self.remainder(off)
        w = self.free(half * max(abs(low), abs(high)))
        for side in (1.0, -1.0):
            self.model.least(name, (w - x * low) * side + (y - low) * half)
            self.model.least(name, (x * high - w) * side + (high - y) * half)
        return w

    def attitude(self, n: int) -> None:
        """Angles at the next knot, eq. (8.17): rates are those of the body turned back by its yaw.

        With a = w_x cos yaw + w_y sin yaw and c across it, roll changes by a / cos pitch, pitch by
        c, and yaw by w_z + a tan pitch.
        """
        model, dt, tube = self.model, self.task.step, self.tube
        (_, pitch, yaw), (_, pitch_half, yaw_half) = tube.angles[n], tube.angles_half[n]
        cos, sin = float(np.cos(yaw)), float(np.sin(yaw))
        w = self.spin[n]
        ahead, beside = w[0] * cos + w[1] * sin, w[1] * cos - w[0] * sin
        turned = self.angles[n][2] - float(yaw)
        slope, sine_off = sine(float(yaw_half))
        level, cosine_off = 0.5 + 0.5 * np.cos(yaw_half), 0.5 - 0.5 * np.cos(yaw_half)
        names, found = "dynamics.attitude", []
        both, ends = (ahead, beside), [self.extent(u) for u in (ahead, beside)]
        size = [max(map(abs, one)) for one in ends]
        longest = float(np.hypot(size[0], size[1])) + LEAST  # turning makes none longer
        for k, sign in ((0, 1.0), (1, -1.0)):
            product = self.envelope(names, turned, float(yaw_half), both[1 - k], *ends[1 - k])
            off = float(cosine_off * size[k] + sine_off * size[1 - k])
            expression = both[k] * float(level) + product * (sign * slope)
            low, high = self.extent(both[k] * float(level))
            reach = off + slope * float(yaw_half) * size[1 - k] + LEAST
            rate = model.variable(max(low - reach, -longest), min(high + reach, longest))
            model.add(names, rate - expression, -off, off)
            found.append(rate)
        along, across = found
        low, high = self.extent(along)
        tilted = self.envelope(
            names, self.angles[n][1] - float(pitch), pitch_half, along, low, high
        )
        size_along = max(abs(low), abs(high))
        secant = straight("secant", float(pitch), float(pitch_half))
        tangent = straight("tangent", float(pitch), float(pitch_half))
        rates = (
            (along * secant.middle + tilted * secant.slope, secant.off * size_along),
            (across, 0.0),
            (w[2] + along * tangent.middle + tilted * tangent.slope, tangent.off * size_along),
        )
        for k, (rate, off) in enumerate(rates):
            rise = self.angles[n + 1][k] - self.angles[n][k] - rate * dt
            model.add(names, rise, -dt * off, dt * off)

    def gyroscopic(self, n: int) -> tuple[list[Lin], Array]:
        """-w x I w about principal axes (3,), and the largest of it (3,): products of two each."""
        model, t = self.model, self.turns[n]
        w = self.spin[n]
        middle = [total(w[j] * float(t.R[j, k]) for j in range(3)) for k in range(3)]
        ends = np.array([self.extent(one) for one in middle])
        seen = self.seen("dynamics.spin", n, middle, ends[:, 0], ends[:, 1])
        axes, spins = t.principal, []
        for k in range(3):
            parts = np.stack([axes[:, k] * t.spin_low, axes[:, k] * t.spin_high])
            about = model.variable(float(t.about_low[k]), float(t.about_high[k]))
            known = total(seen[j] * float(axes[j, k]) for j in range(3))
            model.add(
                "dynamics.spin", about - known, parts.min(axis=0).sum(), parts.max(axis=0).sum()
            )
            spins.append(about)
        ranges = [(float(a), float(b)) for a, b in zip(t.about_low, t.about_high, strict=True)]
        moments, largest = [], np.zeros(3)
        for k in range(3):
            i, j = _AHEAD[k], _LAST[k]
            product = self.product(spins[i], ranges[i], spins[j], ranges[j], _WHOLE)
            moments.append(product * float(t.moments[i] - t.moments[j]))
            size = max(abs(a * b) for a in ranges[i] for b in ranges[j])
            largest[k] = abs(t.moments[i] - t.moments[j]) * size
        return moments, largest
