"""The statement of chapter 8.2.1 as a mixed-integer linear relaxation, in reduced form.

In the world frame the arm of a standing toe has r_z = h - p_z for every leg, so that the eight
products of r_z with forces are two, p_z F_x and p_z F_y. Arms are partitioned, not forces, in
perspective form: each piece of an arm has its own binary, arm and force, and the binaries of a leg
add up to its contact. Products of an arm with f_z are McCormick envelopes, those with f_x and f_y
rows of (arm - end) (mu f_z +- f) >= 0, which vanish with the force. Attitudes and angular
velocities stay within a tube; what turns is linear about its middle with bounded remainders.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.mpc.micp.model import Lin, LinearModel, total
from climbplan.mpc.micp.tube import Tube, Turning, turning
from climbplan.mpc.task import (
    LEGS,
    POSITION,
    VELOCITY,
    Array,
    Flags,
    WalkTask,
    WalkTrajectory,
    Whole,
)

FACETS = 8  # of friction cones, around them


@dataclass(frozen=True)
class Piece:
    """One region and one part of a leg's arm at a knot, and what it holds if it is chosen."""

    region: int
    low: Array  # (2,) ends of the arm along x and y [m]
    high: Array
    chosen: Lin
    arm: tuple[Lin, Lin]
    force: tuple[Lin, Lin, Lin]  # in units of force
    by_x: tuple[Lin, Lin]  # arm_x f_y, arm_x f_z
    by_y: tuple[Lin, Lin]  # arm_y f_x, arm_y f_z

    def beyond(self, arm: Array) -> float:
        """How far an arm (3,) is outside of its part [m]."""
        return float(np.maximum(self.low - arm[:2], arm[:2] - self.high).max())


@dataclass(frozen=True)
class Height:
    """Parts of the body's height at a knot: ends, and the binary of each."""

    low: Array
    high: Array
    chosen: tuple[Lin, ...]


@dataclass(frozen=True)
class Relaxation:
    """The program and the variables that integers are read from."""

    model: LinearModel
    pieces: tuple[tuple[tuple[Piece, ...], ...], ...]  # by knot and leg
    heights: tuple[Height, ...]
    unit: float  # [N] of forces
    states: tuple[tuple[Lin, ...], ...]  # (N + 1) of 12 columns

    def integers(self, found: WalkTrajectory) -> dict[int, float]:
        """Values of all binaries at a motion, by column."""
        values: dict[int, float] = {}
        for n, legs in enumerate(self.pieces):
            arms = found.toes[n] - found.state[n, POSITION]
            for leg, pieces in enumerate(legs):
                own = [q for q in pieces if q.region == found.gait.region[n, leg]]
                held = min(own, key=lambda q: q.beyond(arms[leg]), default=None)
                for q in pieces:
                    stands = found.gait.contact[n, leg] and q is held
                    values[q.chosen.column] = float(stands)
            height, parts = found.state[n, 2], self.heights[n]
            part = int(np.argmax((parts.high >= height - 1e-9) | (parts.high == parts.high[-1])))
            for k, one in enumerate(parts.chosen):
                values[one.column] = float(k == part)
        return values

    def point(self, found: WalkTrajectory) -> dict[int, float]:
        """Binaries, states and forces of a motion, by column: what is left are products."""
        values = self.integers(found)
        for row, columns in zip(found.state, self.states, strict=True):
            values |= {c.column: float(v) for c, v in zip(columns, row, strict=True)}
        for n, legs in enumerate(self.pieces):
            for leg, pieces in enumerate(legs):
                for q in pieces:
                    share = values[q.chosen.column] / self.unit
                    for part, force in zip(q.force, found.force[n, leg], strict=True):
                        values[part.column] = float(share * force)
        return values

    def gait(self, x: Array) -> tuple[Flags, Whole]:
        """Contacts and regions (N, 4) of a point; regions of swinging legs are -1."""
        contact = np.zeros((len(self.pieces), LEGS), bool)
        region = np.full((len(self.pieces), LEGS), -1, np.int64)
        for n, legs in enumerate(self.pieces):
            for leg, pieces in enumerate(legs):
                for piece in pieces:
                    if piece.chosen.at(x) > 0.5:
                        contact[n, leg], region[n, leg] = True, piece.region
        return contact, region


@dataclass(frozen=True)
class Ranges:
    """Where a motion can be that costs less than a known one."""

    velocity: tuple[Array, Array]  # (N + 1, 3) least and largest
    position: tuple[Array, Array]


def ranges_below(task: WalkTask, cost: float) -> Ranges:
    """Velocity and height tracking alone cost no more than a cost; forces move no faster."""
    knots, dt, body = task.knots, task.step, task.body
    start = task.start.state
    most = LEGS * body.force_limit / body.mass
    fastest = np.array([most, most, most - body.gravity])
    slowest = np.array([-most, -most, -body.gravity])
    with np.errstate(divide="ignore"):
        room = np.sqrt(cost / task.weights.velocity)
        rise = np.sqrt(cost / task.weights.height) if task.weights.height else np.inf
    low, high = (np.tile(start[VELOCITY], (knots + 1, 1)) for _ in range(2))
    p_low, p_high = (np.tile(start[POSITION], (knots + 1, 1)) for _ in range(2))
    for n in range(1, knots + 1):
        wanted = task.reference.velocity[n - 1]
        low[n] = np.maximum(low[n - 1] + dt * slowest, wanted - room)
        high[n] = np.minimum(high[n - 1] + dt * fastest, wanted + room)
        p_low[n] = p_low[n - 1] + dt * low[n - 1]
        p_high[n] = p_high[n - 1] + dt * high[n - 1]
        if n > 1:  # the first step is the start's
            p_low[n, 2] = max(p_low[n, 2], task.reference.height[n - 1] - rise)
            p_high[n, 2] = min(p_high[n, 2], task.reference.height[n - 1] + rise)
    return Ranges((low, high), (p_low, p_high))


def relaxation(
    task: WalkTask, tube: Tube, cost: float, arm_pieces: int, height_pieces: int, ratio: float
) -> Relaxation:
    """The program of all motions within a tube that cost less than a known one."""
    return _Build(task, tube, cost, arm_pieces, height_pieces, ratio).done()


class _Build:
    def __init__(
        self, task: WalkTask, tube: Tube, cost: float, arms: int, heights: int, ratio: float
    ) -> None:
        self.task, self.tube, self.cost = task, tube, cost
        self.arm_pieces, self.height_pieces, self.ratio = arms, heights, ratio
        self.model = LinearModel()
        self.arms: dict[tuple[int, int], tuple[Lin, Lin]] = {}
        self.unit = task.weight / LEGS
        self.most = task.body.force_limit / self.unit
        self.turns = [turning(task, tube, n) for n in range(task.knots)]
        ranges = ranges_below(task, cost)
        self.p_low, self.p_high = ranges.position
        self.v_low, self.v_high = ranges.velocity
        level = task.ground.height
        for n in range(2, task.knots):
            low, high = self._body_heights(n)
            self.p_low[n, 2] = max(self.p_low[n, 2], level.min() + low)
            self.p_high[n, 2] = min(self.p_high[n, 2], level.max() + task.lift + high)

    def done(self) -> Relaxation:
        task, knots = self.task, self.task.knots
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
        pieces = [tuple(self._leg(n, leg) for leg in range(LEGS)) for n in range(knots)]
        heights = []
        for n in range(knots):
            force = [total(q.force[k] for leg in pieces[n] for q in leg) for k in range(3)]
            height = self._height(n, force)
            heights.append(height[0])
            self._dynamics(n, pieces[n], force, height[1])
            if task.least_contacts:
                standing = total(q.chosen for leg in pieces[n] for q in leg)
                self.model.add(standing, task.least_contacts, LEGS)
        for n in range(knots - 1):
            for leg in range(LEGS):
                self._no_slip(n, pieces[n][leg], pieces[n + 1][leg], leg)
        self._costs(pieces)
        states = [(*p[n], *v[n], *angles[n], *spin[n]) for n in range(knots + 1)]
        return Relaxation(self.model, tuple(pieces), tuple(heights), self.unit, tuple(states))

    # Legs: workspace (8.20), (8.21), contact and swing (8.23), regions (8.24), friction (8.18)
    def _leg(self, n: int, leg: int) -> tuple[Piece, ...]:
        task, model = self.task, self.model
        first = n == 0
        level, t = task.ground.height, self.turns[n]
        box, half = task.body.toe_center[leg], task.body.toe_half
        held = task.start.toes[leg] - task.start.state[POSITION]
        if first:
            region = int(task.ground.nearest(task.start.toes[leg, :2]))
            ends = [(region, held[:2], held[:2])]
        else:
            low, high = self._arm_range(t, leg)
            knots = np.linspace(low[0], high[0], self.arm_pieces + 1)
            ends = [
                (s, np.array([a, low[1]]), np.array([b, high[1]]))
                for s in self._regions(n, low, high)
                for a, b in itertools.pairwise(knots)
            ]
        pieces = tuple(self._piece(*end) for end in ends)
        standing = total(q.chosen for q in pieces)
        model.add(standing, -np.inf, 1.0)
        if first:
            self.arms[n, leg] = (Lin(constant=held[0]), Lin(constant=held[1]))
            return pieces
        arm = (model.variable(low[0], high[0]), model.variable(low[1], high[1]))
        self.arms[n, leg] = arm
        for k in range(2):
            chosen = total(q.arm[k] for q in pieces)
            # A swinging toe is anywhere in reach.
            model.add(arm[k] - chosen + standing * low[k], low[k], np.inf)
            model.add(arm[k] - chosen + standing * high[k], -np.inf, high[k])
        height = total(q.chosen * float(level[q.region]) for q in pieces)
        clear = (float(level.min() + task.lift), float(level.max() + task.lift))
        toe = model.variable(level.min(), clear[1])
        model.add(toe - height + standing * clear[0], clear[0], np.inf)
        model.add(toe - height + standing * clear[1], -np.inf, clear[1])
        spot = [arm[0], arm[1], toe - self.p[n][2]]
        middle = self.tube.angles[n]
        for k in range(3):
            turned = total(
                (self.angles[n][j] - float(middle[j])) * float(t.slopes[j][k] @ box)
                for j in range(3)
            )
            spot[k] = spot[k] - turned
        off = t.R_off @ half + t.second_order(box)
        for k in range(3):
            seen = total(spot[j] * float(t.R[j, k]) for j in range(3))
            room = float(half[k] + np.abs(t.R[:, k]) @ off)
            model.add(seen, float(box[k]) - room, float(box[k]) + room)
        for q in pieces:
            self._in_region(n, q, arm)
        return pieces

    def _piece(self, region: int, low: Array, high: Array) -> Piece:
        model, most = self.model, self.most
        friction = self.task.ground.friction
        chosen = model.variable(0.0, 1.0, whole=True)
        arm = tuple(self._scaled(chosen, low[k], high[k]) for k in range(2))
        force = (
            self._scaled(chosen, -most, most),
            self._scaled(chosen, -most, most),
            self._scaled(chosen, 0.0, most),
        )
        for k in range(FACETS):
            angle = 2 * np.pi * k / FACETS
            pull = force[0] * float(np.cos(angle)) + force[1] * float(np.sin(angle))
            model.least(force[2] * friction - pull)
        products = []
        for k in range(2):
            ends = float(low[k]), float(high[k])
            with_z = self._product(arm[k], ends, force[2], most, chosen)
            across = self._sideways(ends, force[1 - k], force[2], with_z, friction)
            products.append((across, with_z))
        return Piece(region, low, high, chosen, arm, force, products[0], products[1])

    def _scaled(self, chosen: Lin, low: float, high: float) -> Lin:
        """A variable within [low, high] if chosen, else zero."""
        low, high = float(low), float(high)
        new = self.model.variable(min(low, 0.0), max(high, 0.0))
        self.model.least(new - chosen * low)
        self.model.least(chosen * high - new)
        return new

    def _product(self, x: Lin, ends: tuple[float, float], y: Lin, most: float, chosen: Lin) -> Lin:
        """x y with y in [0, most] if chosen, eq. (8.26) in perspective form."""
        low, high = ends
        if high - low < 1e-12:
            return y * low
        model = self.model
        w = model.variable(-np.inf, np.inf)
        model.least(w - y * low)
        model.least(w - y * high - x * most + chosen * (high * most))
        model.least(y * high - w)
        model.least(y * low + x * most - chosen * (low * most) - w)
        return w

    def _sideways(
        self, ends: tuple[float, float], y: Lin, normal: Lin, with_normal: Lin, friction: float
    ) -> Lin:
        """x y with |y| <= mu times a normal force: (x - end) (mu normal +- y) has its sign."""
        low, high = ends
        if high - low < 1e-12:
            return y * low
        model = self.model
        w = model.variable(-np.inf, np.inf)
        for side in (1.0, -1.0):
            model.least(
                with_normal * friction + w * side - normal * (low * friction) - y * (low * side)
            )
            model.least(
                normal * (high * friction) + y * (high * side) - with_normal * friction - w * side
            )
        return w

    def _arm_range(self, t: Turning, leg: int) -> tuple[Array, Array]:
        """Least and largest arm (3,) of a toe within its box."""
        box, half = self.task.body.toe_center[leg], self.task.body.toe_half
        middle = t.R @ box
        room = np.abs(t.R) @ half + t.R_off @ (np.abs(box) + half)
        return middle - room, middle + room

    def _body_heights(self, n: int) -> tuple[float, float]:
        """Least and largest height of the body above a toe within its box."""
        ends = [self._arm_range(self.turns[n], leg) for leg in range(LEGS)]
        return float(max(-high[2] for _, high in ends)), float(min(-low[2] for low, _ in ends))

    def _regions(self, n: int, low: Array, high: Array) -> list[int]:
        """Regions that a toe can reach."""
        ground = self.task.ground
        least, largest = self.p_low[n, :2] + low[:2], self.p_high[n, :2] + high[:2]
        reached = (ground.lower <= largest).all(axis=1) & (ground.upper >= least).all(axis=1)
        return [int(s) for s in np.flatnonzero(reached)]

    def _in_region(self, n: int, piece: Piece, arm: tuple[Lin, Lin]) -> None:
        ground = self.task.ground
        if len(ground.height) == 1:
            return
        for k in range(2):
            toe = arm[k] + self.p[n][k]
            least = self.p_low[n, k] + min(self._end(n, arm[k], 0), 0.0)
            largest = self.p_high[n, k] + max(self._end(n, arm[k], 1), 0.0)
            low, high = float(ground.lower[piece.region, k]), float(ground.upper[piece.region, k])
            if least < low:
                self.model.least(toe - least - piece.chosen * (low - least))
            if largest > high:
                self.model.least(largest - toe - piece.chosen * (largest - high))

    def _end(self, n: int, arm: Lin, side: int) -> float:
        column = next(iter(arm.terms))
        return (self.model.lower, self.model.upper)[side][column]

    # No slip, eq. (8.22), with M from the ranges of arms and velocity
    def _no_slip(self, n: int, now: tuple[Piece, ...], later: tuple[Piece, ...], leg: int) -> None:
        both = total(q.chosen for q in (*now, *later))
        for k in range(2):
            arm, before = self.arms[n + 1, leg][k], self.arms[n, leg][k]
            moved = arm - before + self.p[n + 1][k] - self.p[n][k]
            low, high = self._extent(moved)
            self.model.least(high * (2.0 - both) - moved)
            self.model.least(moved - low * (2.0 - both))

    def _extent(self, expression: Lin) -> tuple[float, float]:
        """Least and largest value within the bounds of columns."""
        low = high = expression.constant
        for column, value in expression.terms.items():
            ends = sorted((value * self.model.lower[column], value * self.model.upper[column]))
            low, high = low + ends[0], high + ends[1]
        return low, high

    def _height(self, n: int, force: list[Lin]) -> tuple[Height, tuple[Lin, Lin]]:
        """p_z F_x and p_z F_y, eq. (8.26) on parts of the height."""
        model = self.model
        low, high = float(self.p_low[n, 2]), float(self.p_high[n, 2])
        parts = self.height_pieces if high - low > 1e-9 else 1
        knots = np.linspace(low, high, parts + 1)
        chosen, height, sums = [], [], [[], [], []]
        products: tuple[list[Lin], list[Lin]] = ([], [])
        most, friction = LEGS * self.most, self.task.ground.friction
        for a, b in itertools.pairwise(knots):
            one = model.variable(1.0 if parts == 1 else 0.0, 1.0, whole=parts > 1)
            z = self._scaled(one, a, b)
            f = (
                self._scaled(one, -most, most),
                self._scaled(one, -most, most),
                self._scaled(one, 0.0, most),
            )
            with_z = self._product(z, (float(a), float(b)), f[2], most, one)
            for k in range(2):
                ends = float(a), float(b)
                products[k].append(self._sideways(ends, f[k], f[2], with_z, friction))
                model.least(f[2] * friction - f[k])
                model.least(f[2] * friction + f[k])
            chosen.append(one)
            height.append(z)
            for k in range(3):
                sums[k].append(f[k])
        model.add(total(chosen), 1.0, 1.0)
        model.add(total(height) - self.p[n][2], 0.0, 0.0)
        for k in range(3):
            model.add(total(sums[k]) - force[k], 0.0, 0.0)
        found = Height(knots[:-1], knots[1:], tuple(chosen))
        return found, (total(products[0]), total(products[1]))

    # Dynamics, eqs. (8.14) to (8.17), (8.19)
    def _dynamics(
        self,
        n: int,
        legs: tuple[tuple[Piece, ...], ...],
        force: list[Lin],
        raised: tuple[Lin, Lin],
    ) -> None:
        task, model, dt, t = self.task, self.model, self.task.step, self.turns[n]
        level = task.ground.height
        for k in range(3):
            model.add(self.p[n + 1][k] - self.p[n][k] - self.v[n][k] * dt, 0.0, 0.0)
            fall = dt * task.body.gravity if k == 2 else 0.0
            gain = force[k] * (dt * self.unit / task.body.mass)
            model.add(self.v[n + 1][k] - self.v[n][k] - gain + fall, 0.0, 0.0)
        pieces = [q for leg in legs for q in leg]
        moment = [
            total(q.by_y[1] - q.force[1] * float(level[q.region]) for q in pieces) + raised[1],
            total(q.force[0] * float(level[q.region]) - q.by_x[1] for q in pieces) - raised[0],
            total(q.by_x[0] - q.by_y[0] for q in pieces),
        ]
        # How large moments can be: arms times forces within friction
        friction = task.ground.friction
        largest = []
        reach = [np.zeros(3) for _ in range(LEGS)]
        for leg in range(LEGS):
            low, high = self._arm_range(t, leg)
            reach[leg] = np.maximum(np.abs(low), np.abs(high))
        for a, b in ((1, 2), (0, 2), (0, 1)):
            parts = []
            for leg in range(LEGS):
                arm = reach[leg]
                share = arm[a] + friction * arm[b] if b == 2 else friction * (arm[a] + arm[b])
                parts += [q.force[2] * float(share) for q in legs[leg]]
            largest.append(total(parts))
        for k in range(3):
            turned = total(self.spin[n][j] * float(t.rates[k, j]) for j in range(3))
            most = np.abs(self.tube.spin[n]) + self.tube.spin_half[n]
            off = dt * float(t.rates_off[k] @ most)
            rise = self.angles[n + 1][k] - self.angles[n][k] - turned * dt
            model.add(rise, -off, off)
            push = total(moment[j] * float(t.inverse[k, j] * self.unit) for j in range(3))
            change = self.spin[n + 1][k] - self.spin[n][k] - (push + float(t.gyro[k])) * dt
            slack = total(largest[j] * float(t.inverse_off[k, j] * self.unit) for j in range(3))
            slack = (slack + float(t.gyro_off[k])) * dt
            model.least(change + slack)
            model.least(slack - change)

    # Objective, eq. (8.30)
    def _costs(self, pieces: list[tuple[tuple[Piece, ...], ...]]) -> None:
        task, model, w = self.task, self.model, self.task.weights
        reference = task.reference
        motion = w.motion * task.step**2
        for n in range(task.knots + 1):
            for k in range(3):
                track = float(w.velocity[k]) if n > 0 else 0.0
                move = motion if n < task.knots else 0.0
                if track + move == 0.0:
                    continue
                wanted = float(reference.velocity[n - 1, k]) if n > 0 else 0.0
                middle = track * wanted / (track + move)
                model.constant += track * wanted**2 - (track + move) * middle**2
                self._square(track + move, self.v[n][k] - middle)
            if n == 0:
                continue
            for k in range(3):
                off = self.angles[n][k] - float(reference.euler[n - 1, k])
                self._square(float(w.angles[k]), off)
            self._square(w.height, self.p[n][2] - float(reference.height[n - 1]))
        # Ordered pairs of four legs: eight times the squares of three orthogonal contrasts
        signs = ((1, 1, -1, -1), (1, -1, 1, -1), (1, -1, -1, 1))
        for legs in pieces:
            for k in range(3):
                forces = [total(q.force[k] for q in leg) for leg in legs]
                for sign in signs:
                    contrast = total(f * (0.5 * s) for f, s in zip(forces, sign, strict=True))
                    weight = 8.0 * w.force_difference * self.unit**2
                    self._square(weight, contrast)

    def _square(self, weight: float, value: Lin) -> None:
        fixed = all(self.model.lower[c] == self.model.upper[c] for c in value.terms)
        if fixed:
            at = np.zeros(len(self.model.lower))
            for c in value.terms:
                at[c] = self.model.lower[c]
            value = Lin(constant=value.at(at))
        low, high = self._extent(value)
        reach = min(max(abs(low), abs(high)), float(np.sqrt(self.cost / max(weight, 1e-12))))
        self.model.square(weight, value, reach, self.ratio)
