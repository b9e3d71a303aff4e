"""Variables of a motion, and envelopes of products in perspective form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.model import Lin, LinearModel
from climbplan.walking.micp.ranges import Box, ranges_below
from climbplan.walking.micp.tube import Tube, turning
from climbplan.walking.task.task import POSITION, VELOCITY, WalkTask

# Products are lines where these are off by no more: rows of envelopes that lie so near each other
# are the same to a solver whose tolerance is 1e-7, and have it go round in circles.
FINE = 1e-5  # [SI units, forces in quarters of the weight]
LEAST = 1e-7  # a range that is narrower is none


class Frame:
    """States of all knots as variables, within a tube and below a cost."""

    def __init__(
        self,
        task: WalkTask,
        tube: Tube,
        cost: float,
        arms: int,
        heights: int,
        ratio: float,
        box: Box | None,
        plain: bool = False,
        turned: int | None = None,
    ) -> None:
        """plain: inertia is linear about the middle of the tube, in fewer columns.

        turned: knots whose turning is stated; from there on a body only moves. None: all of them.
        """
        self.plain = plain
        self.turned = task.knots if turned is None else min(turned, task.knots)
        self.task, self.tube, self.cost = task, tube, cost
        self.aside: tuple[list[int], list[int]] = ([], [])
        self.given = np.zeros(2)
        self.arm_pieces, self.height_pieces, self.ratio = arms, heights, ratio
        self.model = LinearModel(2.0 * cost)
        self.arms: dict[tuple[int, int], tuple[Lin, Lin]] = {}
        self.legs = task.body.leg_count
        self.unit = task.weight / self.legs
        self.most = task.body.force_limit / self.unit
        self.known = box is not None
        self.box = box = Box.open(task, cost, self.most) if box is None else box
        self.paid: list[tuple[int, float]] = []  # first cost of each interval, and what is given
        self.rows: dict[tuple[int, int], int] = {}  # of whether legs stand, by knot and leg
        self.turns = [turning(task, tube, n) for n in range(task.knots)]
        ranges = ranges_below(task, cost)
        self.p_low, self.p_high = ranges.position
        self.v_low, self.v_high = ranges.velocity
        self.p_low = np.maximum(self.p_low, box.low[:, POSITION])
        self.p_high = np.maximum(np.minimum(self.p_high, box.high[:, POSITION]), self.p_low)
        self.v_low = np.maximum(self.v_low, box.low[:, VELOCITY])
        self.v_high = np.maximum(np.minimum(self.v_high, box.high[:, VELOCITY]), self.v_low)
        for n in range(1, task.knots):
            least, most = self.ways(0, n)
            self.p_low[n, :2] = np.maximum(self.p_low[n, :2], self.p_low[0, :2] + least)
            self.p_high[n, :2] = np.minimum(self.p_high[n, :2], self.p_high[0, :2] + most)
        level = task.ground.height
        for n in range(2, task.knots):
            low, high = self.body_heights(n)
            self.p_low[n, 2] = max(self.p_low[n, 2], level.min() + low)
            self.p_high[n, 2] = min(self.p_high[n, 2], level.max() + task.lift + high)
        self.variables()

    def variables(self) -> None:
        """States at knots 0 to N."""
        knots = self.task.knots
        new = self.model.variable
        p, v, angles, spin = [], [], [], []
        for n in range(knots + 1):
            p.append([new(a, b) for a, b in zip(self.p_low[n], self.p_high[n], strict=True)])
            v.append([new(a, b) for a, b in zip(self.v_low[n], self.v_high[n], strict=True)])
            middle, half = self.tube.angles[n], self.tube.angles_half[n]
            angles.append([new(m - h, m + h) for m, h in zip(middle, half, strict=True)])
            middle, half = self.tube.spin[n], self.tube.spin_half[n]
            last = n == knots  # the last angular velocity turns nothing
            spin.append(
                [
                    new(-np.inf if last else m - h, np.inf if last else m + h)
                    for m, h in zip(middle, half, strict=True)
                ]
            )
        self.p, self.v, self.angles, self.spin = p, v, angles, spin

    def scaled(self, name: str, chosen: Lin, low: float, high: float) -> Lin:
        """A variable within [low, high] if chosen, else zero."""
        low, high = float(low), float(high)
        new = self.model.variable(min(low, 0.0), max(high, 0.0))
        self.model.least(name, new - chosen * low)
        self.model.least(name, chosen * high - new)
        return new

    def product(
        self, x: Lin, ends: tuple[float, float], y: Lin, sizes: tuple[float, float], chosen: Lin
    ) -> Lin:
        """x y with x and y between these if chosen, eq. (8.26) in perspective form."""
        if ends[1] - ends[0] < 1e-12:
            return y * ends[0]
        (low, high), (least, most) = ends, sizes
        if (off := 0.25 * (high - low) * (most - least)) <= FINE:
            a, b = 0.5 * (low + high), 0.5 * (least + most)
            return y * a + x * b - chosen * (a * b) + self.remainder(off)
        w = self.free(max(abs(a * b) for a in ends for b in sizes))
        self.between(w, x, ends, y, sizes, chosen)
        return w

    def remainder(self, off: float) -> Lin:
        """What a line is off a product."""
        off = max(off, LEAST)
        return self.model.variable(-off, off)

    def free(self, largest: float) -> Lin:
        """A column whose rows keep it within so much: its own bounds are never met.

        Without any HiGHS proves no program infeasible, whatever rounding leaves of its coefficient.
        """
        reach = 2.0 * largest + 1.0
        return self.model.variable(-reach, reach)

    def between(
        self,
        w: Lin,
        x: Lin,
        ends: tuple[float, float],
        y: Lin,
        sizes: tuple[float, float],
        chosen: Lin,
    ) -> None:
        """The four rows of w = x y."""
        (low, high), (least, most) = ends, sizes
        add = self.model.least
        add("dynamics.spin", w - y * low - x * least + chosen * (low * least))
        add("dynamics.spin", w - y * high - x * most + chosen * (high * most))
        add("dynamics.spin", y * high + x * least - chosen * (high * least) - w)
        add("dynamics.spin", y * low + x * most - chosen * (low * most) - w)

    def sideways(
        self, ends: tuple[float, float], y: Lin, normal: Lin, with_normal: Lin, friction: float
    ) -> Lin:
        """x y with |y| <= mu times a normal force: (x - end) (mu normal +- y) has its sign."""
        low, high = ends
        if high - low < 1e-12:
            return y * low
        model = self.model
        # |x y| <= |end| mu f, and no f is larger than all legs' together
        w = self.free(max(abs(low), abs(high)) * friction * self.legs * self.most)
        for side in (1.0, -1.0):
            model.least(
                "dynamics.spin",
                with_normal * friction + w * side - normal * (low * friction) - y * (low * side),
            )
            model.least(
                "dynamics.spin",
                normal * (high * friction) + y * (high * side) - with_normal * friction - w * side,
            )
        return w

    def arm_range(self, n: int, leg: int) -> tuple[Array, Array]:
        """Least and largest arm (3,) of a toe within its box, about the axes of the heading."""
        t = self.turns[n]
        return t.arm_low[leg], t.arm_high[leg]

    def body_heights(self, n: int) -> tuple[float, float]:
        """Least and largest height of the body above a toe within its box."""
        t = self.turns[n]
        return float((-t.arm_high[:, 2]).max()), float((-t.arm_low[:, 2]).min())

    def in_world(self, n: int, along: Sequence[Lin]) -> tuple[Lin, Lin]:
        """x and y of a vector whose x and y are about the axes of the heading."""
        (a, b), (c, d) = self.turns[n].facing[:2, :2].tolist()
        return along[0] * a + along[1] * b, along[0] * c + along[1] * d

    def ways(self, n: int, last: int) -> tuple[Array, Array]:
        """Least and largest ways (2,) of the body along x and y from one knot to a later one [m].

        Velocities that are off what is cheapest cost no more than `off` together: by Cauchy and
        Schwarz the root of their number bounds their sum, and not their number. n < last < N.
        """
        task = self.task
        slow, fast = self.v_low[n:last, :2].sum(axis=0), self.v_high[n:last, :2].sum(axis=0)
        first = max(n, 1)  # the first velocity is given, and nothing is paid for it
        track = task.weights.velocity[:2]
        weight = track + task.weights.motion * task.step**2
        with np.errstate(divide="ignore", invalid="ignore"):
            cheapest = np.where(weight > 0, track / weight, 0.0)
            room = np.where(weight > 0, np.sqrt((last - first) * self.box.off / weight), np.inf)
        wanted = cheapest * task.reference.velocity[first - 1 : last - 1, :2].sum(axis=0)
        wanted = wanted + self.v_low[n:first, :2].sum(axis=0)
        least: Array = task.step * np.maximum(slow, wanted - room)
        most: Array = task.step * np.minimum(fast, wanted + room)
        return least, most

    def extent(self, expression: Lin) -> tuple[float, float]:
        """Least and largest value within the bounds of columns."""
        low = high = expression.constant
        for column, value in expression.terms.items():
            ends = sorted((value * self.model.lower[column], value * self.model.upper[column]))
            low, high = low + ends[0], high + ends[1]
        return low, high
