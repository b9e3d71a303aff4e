"""Legs: contact and swing, workspace, regions, friction, and no slip."""

from __future__ import annotations

import itertools

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.model import Lin, total
from climbplan.walking.micp.pieces import Piece
from climbplan.walking.micp.spinning import Spinning
from climbplan.walking.task.task import POSITION

FACETS = 8  # of friction cones, around them


class Legs(Spinning):
    """Rows of each leg at each knot."""

    # Legs: workspace (8.20), (8.21), contact and swing (8.23), regions (8.24), friction (8.18)
    def leg(self, n: int, leg: int) -> tuple[Piece, ...]:
        task, model = self.task, self.model
        first = n == 0
        level, t = task.ground.height, self.turns[n]
        held = t.facing.T @ (task.start.toes[leg] - task.start.state[POSITION])
        if first:
            region = int(task.ground.nearest(task.start.toes[leg, :2]))
            ends = [(region, held[:2], held[:2])]
        else:
            low, high = self.arm_range(n, leg)
            least = np.maximum(low[:2], self.box.arm_low[n, leg])
            most = np.maximum(np.minimum(high[:2], self.box.arm_high[n, leg]), least)
            knots = np.linspace(least[0], most[0], self.arm_pieces + 1)
            ends = [
                (s, np.array([a, least[1]]), np.array([b, most[1]]))
                for s in self.regions(n, least, most)
                for a, b in itertools.pairwise(knots)
            ]
        forces = self.box.force_low[n, leg], self.box.force_high[n, leg]
        pieces = tuple(self.piece(*end, forces, n < self.turned) for end in ends)
        standing = total(q.chosen for q in pieces)
        self.rows[n, leg] = len(model)
        stands = float(self.box.stands_low[n, leg]), float(self.box.stands_high[n, leg])
        model.add("contact.region", standing, *stands)
        if first:
            self.arms[n, leg] = (Lin(constant=held[0]), Lin(constant=held[1]))
            return pieces
        if stands[0] > 0.0:  # where it stands in any case
            low, high = (np.append(end, other[2]) for end, other in ((least, low), (most, high)))
        arm = (model.variable(low[0], high[0]), model.variable(low[1], high[1]))
        self.arms[n, leg] = arm
        for k in range(2):
            chosen = total(q.arm[k] for q in pieces)
            # A swinging toe is anywhere in reach.
            model.add("contact.region", arm[k] - chosen + standing * low[k], low[k], np.inf)
            model.add("contact.region", arm[k] - chosen + standing * high[k], -np.inf, high[k])
        height = total(q.chosen * float(level[q.region]) for q in pieces)
        clear = (float(level.min() + task.lift), float(level.max() + task.lift))
        toe = model.variable(level.min(), clear[1])
        model.add("swing.height", toe - height + standing * clear[0], clear[0], np.inf)
        model.add("swing.height", toe - height + standing * clear[1], -np.inf, clear[1])
        if n < self.turned:
            self.workspace(n, leg, (arm[0], arm[1], toe - self.p[n][2]))
        for q in pieces:
            self.in_region(n, q, arm)
        return pieces

    def workspace(self, n: int, leg: int, arm: tuple[Lin, Lin, Lin]) -> None:
        """The toe in its box, seen from the body."""
        model, t = self.model, self.turns[n]
        box, half = self.task.body.toe_center[leg], self.task.body.toe_half
        low, high = t.toe_low[leg].copy(), t.toe_high[leg].copy()
        ends, middle = [self.extent(r) for r in arm], t.facing.T @ t.R
        seen = [total(arm[j] * float(middle[j, k]) for j in range(3)) for k in range(3)]
        for k in range(3):
            corners = [sorted(float(middle[j, k]) * e for e in ends[j]) for j in range(3)]
            low[k] = max(low[k], sum(c[0] for c in corners))
            high[k] = min(high[k], sum(c[1] for c in corners))
            model.add("workspace.toe", seen[k], low[k], high[k])
        found = self.seen("workspace.toe", n, seen, low, high)
        least, most = box - half - t.bent_high[leg], box + half - t.bent_low[leg]
        for k in range(3):
            model.add("workspace.toe", found[k], float(least[k]), float(most[k]))

    def piece(
        self, region: int, low: Array, high: Array, forces: tuple[Array, Array], turns: bool
    ) -> Piece:
        """turns: there are products of its arm with its force."""
        model = self.model
        friction = self.task.ground.friction
        chosen = model.variable(0.0, 1.0, whole=True)
        arm = (
            self.scaled("contact.region", chosen, float(low[0]), float(high[0])),
            self.scaled("contact.region", chosen, float(low[1]), float(high[1])),
        )
        least, most = forces
        x, y, z = (self.scaled("force.swing", chosen, a, b) for a, b in zip(*forces, strict=True))
        force = (x, y, z)
        for k in range(FACETS):
            angle = 2 * np.pi * k / FACETS
            pull = force[0] * float(np.cos(angle)) + force[1] * float(np.sin(angle))
            model.least("force.friction", force[2] * friction - pull)
        products = []
        for k in range(2):
            if not turns:
                products.append((Lin(), Lin()))
                continue
            ends = float(low[k]), float(high[k])
            with_z = self.product(arm[k], ends, z, (float(least[2]), float(most[2])), chosen)
            across = self.sideways(ends, force[1 - k], z, with_z, friction)
            if self.known and high[k] - low[k] > 1e-12:
                sizes = float(least[1 - k]), float(most[1 - k])
                self.between(across, arm[k], ends, force[1 - k], sizes, chosen)
            products.append((across, with_z))
        return Piece(region, low, high, chosen, arm, force, products[0], products[1])

    def regions(self, n: int, low: Array, high: Array) -> list[int]:
        """Regions that a toe can reach."""
        ground = self.task.ground
        facing = self.turns[n].facing[:2, :2]
        middle, half = facing @ (0.5 * (low + high)[:2]), np.abs(facing) @ (0.5 * (high - low)[:2])
        least, largest = self.p_low[n, :2] + middle - half, self.p_high[n, :2] + middle + half
        reached = (ground.lower <= largest).all(axis=1) & (ground.upper >= least).all(axis=1)
        return [int(s) for s in np.flatnonzero(reached)]

    def in_region(self, n: int, piece: Piece, arm: tuple[Lin, Lin]) -> None:
        ground = self.task.ground
        if len(ground.height) == 1:
            return
        for k, along in enumerate(self.in_world(n, arm)):
            toe, ends = along + self.p[n][k], self.extent(along)
            least = self.p_low[n, k] + min(ends[0], 0.0)
            largest = self.p_high[n, k] + max(ends[1], 0.0)
            low, high = float(ground.lower[piece.region, k]), float(ground.upper[piece.region, k])
            if least < low:
                self.model.least("contact.region", toe - least - piece.chosen * (low - least))
            if largest > high:
                self.model.least("contact.region", largest - toe - piece.chosen * (largest - high))

    # No slip, eq. (8.22): a leg stands through, and its arm changes by -v dt, or it does not; the
    # hull of both instead of M
    def no_slip(self, n: int, now: tuple[Piece, ...], later: tuple[Piece, ...]) -> None:
        model, dt = self.model, self.task.step
        before, after = total(q.chosen for q in now), total(q.chosen for q in later)
        through = model.variable(0.0, 1.0)
        model.least("contact.no_slip", before - through)
        model.least("contact.no_slip", after - through)
        model.least("contact.no_slip", through - before - after + 1.0)
        arms: list[tuple[Lin, Lin]] = []
        for at, pieces, standing in ((n, now, before), (n + 1, later, after)):
            held = []
            for k in range(2):
                low = min(float(q.low[k]) for q in pieces)
                high = max(float(q.high[k]) for q in pieces)
                arm = self.scaled("contact.no_slip", through, low, high)
                left = total(q.arm[k] for q in pieces) - arm
                model.least("contact.no_slip", left - (standing - through) * low)
                model.least("contact.no_slip", (standing - through) * high - left)
                held.append(arm)
            arms.append(self.in_world(at, held))
        for k in range(2):
            low, high = float(self.v_low[n, k]), float(self.v_high[n, k])
            velocity = self.scaled("contact.no_slip", through, low, high)
            other = self.v[n][k] - velocity
            model.least("contact.no_slip", other - (1.0 - through) * low)
            model.least("contact.no_slip", (1.0 - through) * high - other)
            model.add("contact.no_slip", arms[1][k] - arms[0][k] + velocity * dt, 0.0, 0.0)

    def endurance(self, pieces: list[tuple[tuple[Piece, ...], ...]]) -> None:
        """No leg stands for longer than the body needs to leave it out of reach at its slowest."""
        knots, held = self.task.knots, self.task.start
        reach = [
            [(t.reach_low[leg], t.reach_high[leg]) for leg in range(self.legs)] for t in self.turns
        ]
        for leg in range(self.legs):
            there = held.toes[leg] - held.state[POSITION]
            reach[0][leg] = (there, there)
            standing = [total(q.chosen for q in pieces[n][leg]) for n in range(knots)]
            for n in range(knots):
                for last in range(n + 1, knots):
                    slow, fast = self.ways(n, last)
                    # The arm changes by minus the way of the body.
                    least = reach[n][leg][0][:2] - reach[last][leg][1][:2]
                    most = reach[n][leg][1][:2] - reach[last][leg][0][:2]
                    if (slow > most + 1e-9).any() or (fast < least - 1e-9).any():
                        self.model.add(
                            "contact.endurance",
                            total(standing[n : last + 1]),
                            -np.inf,
                            float(last - n),
                        )
                        break
