"""An independent way to the least movement: all slots, all states, a grid of tilts, then a polish.

Geometry by horizontal slices (two convex bodies on the ground overlap if some slice does), contact
by bisection on polygon distance, centres by DAQP. Shares no code with the solver or the checker.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import daqp
import numpy as np
from scipy.optimize import minimize

FLAT, LEFT, UPRIGHT, RIGHT = range(4)
TILT = {FLAT: math.pi / 2, UPRIGHT: 0.0}


@dataclass(frozen=True)
class Rules:
    left: float = -81.11
    right: float = 81.11
    height: float = 110.0
    book_gap: float = 4.1
    wall_gap: float = 1.5


Point = tuple[float, float]
Outline = list[Point]


def outline(angle: float, h: float, w: float) -> Outline:
    """Corners (x, y) around the centre's x, lowest point at 0; plain floats, which are faster."""
    c, s = math.cos(angle), math.sin(angle)
    base = [(-w / 2, -h / 2), (w / 2, -h / 2), (w / 2, h / 2), (-w / 2, h / 2)]
    points = [(c * x - s * y, s * x + c * y) for x, y in base]
    ground = min(y for _, y in points)
    return [(x, y - ground) for x, y in points]


def reach(points: Outline) -> float:
    """Half the width over the ground."""
    return max(x for x, _ in points)


def slice_ends(points: Outline, height: float) -> tuple[float, float]:
    """Leftmost and rightmost x of a convex polygon at a height."""
    low, high = math.inf, -math.inf
    xa, ya = points[3]
    for xb, yb in points:
        if min(ya, yb) - 1e-12 <= height <= max(ya, yb) + 1e-12:
            if abs(yb - ya) < 1e-12:
                low, high = min(low, xa, xb), max(high, xa, xb)
            else:
                x = xa + (height - ya) / (yb - ya) * (xb - xa)
                low, high = min(low, x), max(high, x)
        xa, ya = xb, yb
    return low, high


def apart(a: Outline, b: Outline) -> float:
    """Least x_b - x_a with b right of a: the widest slice at one of the corners' heights."""
    top = min(max(y for _, y in a), max(y for _, y in b))
    heights = {0.0, top} | {y for _, y in (*a, *b) if 0 <= y <= top}
    return max(slice_ends(a, y)[1] - slice_ends(b, y)[0] for y in heights)


def polygon_distance(a: Outline, b: Outline, shift: float) -> float:
    """Distance of two convex polygons that do not overlap, b moved to the right by `shift`."""
    best = math.inf
    for p, q, move in ((a, b, -shift), (b, a, shift)):
        xa, ya = q[3]
        for xb, yb in q:
            ex, ey = xb - xa, yb - ya
            length = ex * ex + ey * ey
            for x, y in p:
                dx, dy = x + move - xa, y - ya
                along = min(max((dx * ex + dy * ey) / length, 0.0), 1.0)
                dx, dy = dx - along * ex, dy - along * ey
                best = min(best, dx * dx + dy * dy)
            xa, ya = xb, yb
    return math.sqrt(best)


def farthest(a: Outline, b: Outline, gap: float) -> float:
    """Largest x_b - x_a with b right of a and within the gap."""
    low = apart(a, b)
    high = low + 60 * gap + 200
    for _ in range(50):
        middle = (low + high) / 2
        if polygon_distance(a, b, middle) <= gap:
            low = middle
        else:
            high = middle
    return low


class Oracle:
    """One scene: theta row in mm."""

    def __init__(self, theta: np.ndarray, rules: Rules = Rules()) -> None:
        rows = theta[:-2].reshape(-1, 5)
        self.n, self.rules = len(rows), rules
        self.x0, self.y0, self.a0 = rows[:, 0], rows[:, 1], rows[:, 2]
        self.size = [(h, w) for h, w in rows[:, 3:]] + [(theta[-2], theta[-1])]

        self._bodies: dict[tuple[int, float], Outline] = {}
        self._aparts: dict[tuple[int, float, int, float], float] = {}
        self._farthests: dict[tuple[int, float, int, float], float] = {}

    def _body(self, k: int, angle: float) -> Outline:
        if (k, angle) not in self._bodies:
            self._bodies[k, angle] = outline(angle, *self.size[k])
        return self._bodies[k, angle]

    def _apart(self, i: int, a: float, j: int, b: float) -> float:
        key = (i, a, j, b)
        if key not in self._aparts:
            self._aparts[key] = apart(self._body(i, a), self._body(j, b))
        return self._aparts[key]

    def _farthest(self, i: int, a: float, j: int, b: float) -> float:
        key = (i, a, j, b)
        if key not in self._farthests:
            gap = self.rules.book_gap
            self._farthests[key] = farthest(self._body(i, a), self._body(j, b), gap)
        return self._farthests[key]

    def turn_cost(self, k: int, tilt: float) -> float:
        h, w = self.size[k]
        y = (w * math.sin(tilt) + h * math.cos(tilt)) / 2
        return (y - self.y0[k]) ** 2 + (math.cos(tilt) - math.cos(self.a0[k])) ** 2

    def place(self, slot: int, states: tuple[int, ...], tilts: tuple[float, ...]) -> float:
        """Least cost with these states and tilts (n + 1 each), infinite if there is none."""
        n, rules = self.n, self.rules
        for k in range(n + 1):
            h, w = self.size[k]
            if w * math.sin(tilts[k]) + h * math.cos(tilts[k]) > rules.height + 1e-9:
                return math.inf
        angles = [-t if s == RIGHT else t for s, t in zip(states, tilts, strict=True)]
        order = [*range(slot), n, *range(slot, n)]
        rows, low, high = [], [], []

        def row(i: int, j: int | None, least: float, most: float) -> None:
            r = np.zeros(n + 1)
            r[i] = 1
            if j is not None:
                r[j] = -1
            rows.append(r)
            low.append(least)
            high.append(most)

        for first, second in itertools.combinations(order, 2):
            least = self._apart(first, angles[first], second, angles[second])
            if first < n and second < n:
                least = max(least, 0.0)
            most = 1e30
            neighbours = second - first == 1 and second < n
            if neighbours and (states[first] == RIGHT or states[second] == LEFT):
                most = self._farthest(first, angles[first], second, angles[second])
            row(second, first, least, most)
        for k in range(n + 1):
            half = reach(self._body(k, angles[k]))
            least, most = rules.left + half, rules.right - half
            if k == 0 and n > 0 and states[0] == LEFT:
                most = min(most, least + rules.wall_gap)
            if k == n - 1 and states[k] == RIGHT:
                least = max(least, rules.right - half - rules.wall_gap)
            if least > most:
                return math.inf
            row(k, None, least, most)
        weight = np.append(np.full(n, 2.0), 1e-7)
        linear = np.append(-2.0 * self.x0, 0.0)
        z, _, flag, _ = daqp.solve(
            np.diag(weight),
            linear,
            np.ascontiguousarray(rows),
            np.array(high),
            np.array(low),
            np.zeros(len(rows), dtype=np.int32),
            primal_tol=1e-9,
        )
        if flag < 1:
            return math.inf
        cost = float(((z[:n] - self.x0) ** 2).sum())
        return cost + sum(self.turn_cost(k, tilts[k]) for k in range(n))

    def solve(self, steps: tuple[int, int, int] = (48, 20, 10), polish: int = 8) -> float:
        """Least cost over everything, up to grid and polish; steps by number of leaning books."""
        n, best = self.n, math.inf
        tries = []
        for states in itertools.product(range(4), repeat=n):
            leaning = sum(s in (LEFT, RIGHT) for s in states)
            count = steps[min(leaning, len(steps)) - 1]
            axes = []
            for k, s in enumerate(states):
                h, w = self.size[k]
                least = math.atan2(w, h)
                lean = (*np.linspace(least, math.pi / 2, count), *self._likely(k, least))
                axes.append(lean if s in (LEFT, RIGHT) else (TILT[s],))
            points = sorted(
                (sum(self.turn_cost(k, t) for k, t in enumerate(tilts)), tilts)
                for tilts in itertools.product(*axes)
            )
            tries.append((leaning > 0, points[0][0], states, points))
        tries.sort(key=lambda t: t[:3])
        starts = []
        for _, _, states, points in tries:
            for slot, inserted in itertools.product(range(n + 1), (UPRIGHT, FLAT)):
                found = (math.inf, points[0][1])
                for turn, tilts in points:
                    # The grid may miss the least turn cost by a little.
                    if turn > min(best + 40, found[0]):
                        break
                    if self._crowded(slot, (*states, inserted), (*tilts, TILT[inserted]), best):
                        continue
                    cost = self.place(slot, (*states, inserted), (*tilts, TILT[inserted]))
                    if cost < found[0]:
                        found = (cost, tilts)
                    best = min(best, cost)
                if found[0] < math.inf:
                    starts.append(
                        (found[0], slot, (*states, inserted), (*found[1], TILT[inserted]))
                    )
        starts.sort(key=lambda t: t[0])
        for cost, slot, states, tilts in starts[:polish]:
            best = min(best, cost, self._polish(slot, states, tilts))
        return best

    def _likely(self, k: int, least: float) -> tuple[float, ...]:
        """The tilt the book has."""
        tilt = abs(math.remainder(self.a0[k], 2 * math.pi))
        return (tilt,) if least < tilt < math.pi / 2 else ()

    def _crowded(
        self, slot: int, states: tuple[int, ...], tilts: tuple[float, ...], best: float
    ) -> bool:
        """Whether neighbours alone need more room than there is, or more movement than `best`."""
        n, rules = self.n, self.rules
        angles = [-t if s == RIGHT else t for s, t in zip(states, tilts, strict=True)]
        order = [*range(slot), n, *range(slot, n)]
        at = rules.left + reach(self._body(order[0], angles[order[0]]))
        where = {order[0]: at}
        for i, j in itertools.pairwise(order):
            at += self._apart(i, angles[i], j, angles[j])
            where[j] = at
        over = at + reach(self._body(order[-1], angles[order[-1]])) - rules.right
        return over > 1e-9 or any(
            max(0.0, where[k] - self.x0[k]) ** 2 > best + 40 for k in range(n)
        )

    def _polish(self, slot: int, states: tuple[int, ...], tilts: tuple[float, ...]) -> float:
        leans = [k for k, s in enumerate(states) if s in (LEFT, RIGHT)]
        if not leans:
            return self.place(slot, states, tilts)
        limits = [math.atan2(self.size[k][1], self.size[k][0]) for k in leans]

        def cost(v: np.ndarray) -> float:
            full = list(tilts)
            for k, value, least in zip(leans, v, limits, strict=True):
                full[k] = min(max(float(value), least), math.pi / 2)
            value = self.place(slot, states, tuple(full))
            return min(value, 1e9)

        x = np.array([tilts[k] for k in leans])
        best = cost(x)
        for size in (0.05, 0.01, 0.002):
            simplex = np.vstack([x, *(x + size * e for e in np.eye(len(leans)))])
            result = minimize(
                cost,
                x,
                method="Nelder-Mead",
                options={"initial_simplex": simplex, "xatol": 1e-7, "fatol": 1e-7, "maxfev": 400},
            )
            if result.fun < best:
                best, x = float(result.fun), result.x
        return best
