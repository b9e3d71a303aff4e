"""The body: moments by its height, dynamics, and the cost."""

from __future__ import annotations

import itertools

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.counts import Count, Counts
from climbplan.walking.micp.model import Lin, total
from climbplan.walking.micp.pieces import Height, Piece
from climbplan.walking.task.task import VELOCITY

_AHEAD, _LAST = (1, 2, 0), (2, 0, 1)


class Motion(Counts):
    """Rows of the body from each knot to the next, and the squares of the cost."""

    def height(self, n: int, force: list[Lin]) -> tuple[Height, tuple[Lin, Lin]]:
        """p_z F_x and p_z F_y, eq. (8.26) on parts of the height."""
        model = self.model
        low, high = float(self.p_low[n, 2]), float(self.p_high[n, 2])
        if n >= self.turned:
            all_of_it = np.array([low]), np.array([high])
            return Height(*all_of_it, (model.variable(1.0, 1.0),)), (Lin(), Lin())
        parts = self.height_pieces if high - low > 1e-9 else 1
        knots = np.linspace(low, high, parts + 1)
        chosen, height = [], []
        sums: tuple[list[Lin], ...] = ([], [], [])
        products: tuple[list[Lin], list[Lin]] = ([], [])
        friction = self.task.ground.friction
        least, most = self.box.push_low[n], self.box.push_high[n]
        for a, b in itertools.pairwise(knots):
            one = model.variable(1.0 if parts == 1 else 0.0, 1.0, whole=parts > 1)
            z = self.scaled("dynamics.spin", one, a, b)
            ends = float(a), float(b)
            f = [self.scaled("force.limit", one, x, y) for x, y in zip(least, most, strict=True)]
            with_z = self.product(z, ends, f[2], (float(least[2]), float(most[2])), one)
            for k in range(2):
                across = self.sideways(ends, f[k], f[2], with_z, friction)
                if self.known and b - a > 1e-12:
                    self.between(across, z, ends, f[k], (float(least[k]), float(most[k])), one)
                products[k].append(across)
                model.least("force.friction", f[2] * friction - f[k])
                model.least("force.friction", f[2] * friction + f[k])
            chosen.append(one)
            height.append(z)
            for k in range(3):
                sums[k].append(f[k])
        model.add("dynamics.spin", total(chosen), 1.0, 1.0)
        model.add("dynamics.spin", total(height) - self.p[n][2], 0.0, 0.0)
        for k in range(3):
            model.add("dynamics.spin", total(sums[k]) - force[k], 0.0, 0.0)
        found = Height(knots[:-1], knots[1:], tuple(chosen))
        return found, (total(products[0]), total(products[1]))

    # Dynamics, eqs. (8.14) to (8.17), (8.19)
    def dynamics(
        self,
        n: int,
        legs: tuple[tuple[Piece, ...], ...],
        force: list[Lin],
        raised: tuple[Lin, Lin],
    ) -> None:
        task, model, dt, t = self.task, self.model, self.task.step, self.turns[n]
        level = task.ground.height
        pushed = (*self.in_world(n, force), force[2])
        for k in range(3):
            model.add(
                "dynamics.position", self.p[n + 1][k] - self.p[n][k] - self.v[n][k] * dt, 0.0, 0.0
            )
            fall = dt * task.body.gravity if k == 2 else 0.0
            gain = pushed[k] * (dt * self.unit / task.body.mass)
            model.add("dynamics.velocity", self.v[n + 1][k] - self.v[n][k] - gain + fall, 0.0, 0.0)
        if n >= self.turned:
            return
        pieces = [q for leg in legs for q in leg]
        along = [
            total(q.by_y[1] - q.force[1] * float(level[q.region]) for q in pieces) + raised[1],
            total(q.force[0] * float(level[q.region]) - q.by_x[1] for q in pieces) - raised[0],
            total(q.by_x[0] - q.by_y[0] for q in pieces),
        ]
        moment = [*self.in_world(n, along), along[2]]
        # How large moments can be: arms times forces within friction
        friction = task.ground.friction
        largest = []
        reach = np.maximum(np.abs(t.reach_low), np.abs(t.reach_high))
        for a, b in ((1, 2), (0, 2), (0, 1)):
            parts = []
            for leg in range(self.legs):
                arm = reach[leg]
                share = arm[a] + friction * arm[b] if b == 2 else friction * (arm[a] + arm[b])
                parts += [q.force[2] * float(share) for q in legs[leg]]
            largest.append(total(parts))
        self.attitude(n)
        about, about_most = self.gyroscopic(n)
        # About principal axes of the body: the world sees them from the middle of the tube.
        seen, off = t.R @ t.principal, t.R_off @ np.abs(t.principal)
        for k in range(3):
            push = total(moment[j] * float(t.inverse[k, j] * self.unit) for j in range(3))
            gyro = total(about[j] * float(seen[k, j] / t.moments[j]) for j in range(3))
            change = self.spin[n + 1][k] - self.spin[n][k] - (push + gyro) * dt
            slack = total(largest[j] * float(t.inverse_off[k, j] * self.unit) for j in range(3))
            slack = (slack + float(off[k] @ (about_most / t.moments))) * dt
            model.least("dynamics.spin", change + slack)
            model.least("dynamics.spin", slack - change)

        if n + 1 < task.knots and self.plain:
            given = [total(about[j] * float(seen[k, j]) for j in range(3)) for k in range(3)]
            self.turned_plainly(n, moment, given, off @ about_most)
        elif n + 1 < task.knots:
            self.turned_by(n, moment, about, about_most)

    def turned_plainly(self, n: int, moment: list[Lin], gyro: list[Lin], gyro_off: Array) -> None:
        """What turns the body, eq. (8.15) times the inertia: |I - I_middle| meets accelerations.

        Those are small beside moments at their largest, which the rows above have to reckon with.
        gyro: gyroscopic moments (3,), world frame, right within so much (3,).
        """
        dt, t = self.task.step, self.turns[n]
        change = [self.spin[n + 1][j] - self.spin[n][j] for j in range(3)]
        fastest = np.array([max(map(abs, self.extent(one))) / dt for one in change])
        slack = t.inertia_off @ fastest + gyro_off
        for k in range(3):
            heavy = total(change[j] * float(t.inertia[k, j] / dt) for j in range(3))
            left = heavy - moment[k] * self.unit - gyro[k]
            self.model.add("dynamics.spin", left, -float(slack[k]), float(slack[k]))

    def turned_by(self, n: int, moment: list[Lin], gyro: list[Lin], gyro_most: Array) -> None:
        """What turns the body, eq. (8.15) times the inertia, about principal axes at the middle.

        Q I Q^T a = m + Q g, with accelerations a, moments m, and the gyroscopic g about the body's
        own axes: to first order Q is 1 + [w], and [w] I - I [w] has differences of moments of
        inertia, so that w meets one expression for each pair of axes. What is of second order
        meets largest accelerations, and not moments, which forces have far larger.
        gyro: (3,) no larger than `gyro_most` (3,).
        """
        t, name = self.turns[n], "dynamics.spin"
        middle = t.R @ t.principal
        change = [
            (self.spin[n + 1][j] - self.spin[n][j]) * (1.0 / self.task.step) for j in range(3)
        ]
        a = [total(change[j] * float(middle[j, k]) for j in range(3)) for k in range(3)]
        turn, reach = self.turn_about(n)
        ends = np.array([self.extent(one) for one in a])
        for i in range(3):
            left = a[i] * float(t.moments[i]) - gyro[i]
            for j, k, sign in ((_AHEAD[i], _LAST[i], -1.0), (_LAST[i], _AHEAD[i], 1.0)):
                further = float(t.moments[j] - t.moments[i])
                z = a[j] * further - gyro[j]
                low = float((further * ends[j]).min() - gyro_most[j])
                high = float((further * ends[j]).max() + gyro_most[j])
                left = left + self.envelope(name, turn[k], float(reach[k]), z, low, high) * sign
            push = total(moment[j] * float(middle[j, i] * self.unit) for j in range(3))
            heavy = [b * e for b in (t.heavy_low[i], t.heavy_high[i]) for e in ends.T]
            carried = [
                b * e
                for b in (t.carried_low[i], t.carried_high[i])
                for e in (-gyro_most, gyro_most)
            ]
            least = -np.max(heavy, axis=0).sum() + np.min(carried, axis=0).sum()
            most = -np.min(heavy, axis=0).sum() + np.max(carried, axis=0).sum()
            self.model.add(name, left - push, float(least), float(most))

    # Objective, eq. (8.30)
    def costs(self, pieces: list[tuple[tuple[Piece, ...], ...]]) -> list[tuple[Count, ...]]:
        task, w = self.task, self.task.weights
        step = task.start.state[VELOCITY] * task.step
        self.model.constant += w.motion * float(step @ step)
        counts = [self.counts(n, legs) for n, legs in enumerate(pieces)]
        for n, legs in enumerate(pieces):
            self.paid.append((len(self.model.lower), self.model.constant))
            self.tracking(n + 1, counts[n], counts[n + 1] if n + 1 < task.knots else ())
            self.differences(legs, counts[n])
            for k in range(3):
                off = self.angles[n + 1][k] - float(task.reference.euler[n, k])
                self.square("cost.tracking", float(w.angles[k]), off)
            self.square(
                "cost.tracking", w.height, self.p[n + 1][2] - float(task.reference.height[n])
            )
        return counts
