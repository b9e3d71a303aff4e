"""The statement of chapter 8.2.1 as a mixed-integer linear relaxation, in reduced form.

In the world frame the arm of a standing toe has r_z = h - p_z for every leg, so that the eight
products of r_z with forces are two, p_z F_x and p_z F_y. Arms are partitioned, not forces, in
perspective form: each piece of an arm has its own binary, arm and force, and the binaries of a leg
add up to its contact. Products of an arm with f_z are McCormick envelopes, those with f_x and f_y
rows of (arm - end) (mu f_z +- f) >= 0, which vanish with the force. Arms and forces are about axes
that are turned by the yaw of the tube's middle at each knot: boxes of toes are narrowest about
these. Attitudes and angular velocities stay within a tube; products with the small turn from its
middle are in envelopes, and what is of second order is a bounded remainder.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.micp.counts import Count
from climbplan.walking.micp.model import Lin, LinearModel, total
from climbplan.walking.micp.motion import Motion
from climbplan.walking.micp.pieces import Height, Piece
from climbplan.walking.micp.ranges import Box
from climbplan.walking.micp.tube import Tube
from climbplan.walking.task.task import POSITION, WalkTask, WalkTrajectory


@dataclass(frozen=True)
class Relaxation:
    """The program and the variables that integers are read from."""

    model: LinearModel
    pieces: tuple[tuple[tuple[Piece, ...], ...], ...]  # by knot and leg
    heights: tuple[Height, ...]
    counts: tuple[tuple[Count, ...], ...]  # by knot
    unit: float  # [N] of forces
    states: tuple[tuple[Lin, ...], ...]  # (N + 1) of 12 columns
    aside: tuple[
        tuple[int, ...], ...
    ]  # columns of what velocities along x and y cost, but the last
    given: Array  # (2,) cost of those of them that are no variables
    most: float  # that motions cost
    rows: IntArray  # (N, L) of whether legs stand
    known: int  # the row of what motions cost
    box: Box  # what is known already
    turned: int  # knots whose turning is stated
    paid: tuple[tuple[int, float], ...]  # (N) of each interval: its first cost, and what is given
    facing: Array  # (N, 3, 3) axes that arms and forces are about, columns

    def paid_after(self, knots: int) -> tuple[Array, float]:
        """Costs of columns, and a constant, of what is paid for the intervals from a knot on."""
        first, given = self.paid[knots]
        cost = np.array(self.model.cost)
        cost[:first] = 0.0
        return cost, self.model.constant - given

    def integers(self, found: WalkTrajectory) -> dict[int, float]:
        """Values of all binaries at a motion, by column."""
        values: dict[int, float] = {}
        for n, legs in enumerate(self.pieces):
            arms = (found.toes[n] - found.state[n, POSITION]) @ self.facing[n]
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
            for count in self.counts[n]:
                values[count.chosen.column] = float(found.gait.contact[n].sum() == count.legs)
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
                    along = found.force[n, leg] @ self.facing[n]
                    for part, force in zip(q.force, along, strict=True):
                        values[part.column] = float(share * force)
        return values

    def standing(self, x: Array) -> Array:
        """Shares of contacts (N, L) at a point."""
        return np.array([[total(q.chosen for q in leg).at(x) for leg in n] for n in self.pieces])

    def gait(self, x: Array, share: float = 0.5) -> tuple[BoolArray, IntArray]:
        """Contacts beyond a share and regions (N, L) of a point; of swinging legs -1."""
        contact = np.zeros((len(self.pieces), len(self.pieces[0])), bool)
        region = np.full((len(self.pieces), len(self.pieces[0])), -1, np.int64)
        for n, legs in enumerate(self.pieces):
            for leg, pieces in enumerate(legs):
                chosen = [piece.chosen.at(x) for piece in pieces]
                if sum(chosen) > share:
                    largest = pieces[int(np.argmax(chosen))]
                    contact[n, leg], region[n, leg] = True, largest.region
        return contact, region


def relaxation(
    task: WalkTask,
    tube: Tube,
    cost: float,
    arm_pieces: int,
    height_pieces: int,
    ratio: float,
    box: Box | None = None,
    plain: bool = False,
    turned: int | None = None,
) -> Relaxation:
    """The program of all motions within a tube that cost no more than so much.

    ratio: of tangents, as of `LinearModel.square`; box: what is known of such motions; plain
    and turned: as of `Frame`.
    """
    pieces = arm_pieces, height_pieces
    return _Statement(task, tube, cost, *pieces, ratio, box, plain, turned).done()


class _Statement(Motion):
    def done(self) -> Relaxation:
        task, knots = self.task, self.task.knots
        p, v, angles, spin = self.p, self.v, self.angles, self.spin
        pieces = [tuple(self.leg(n, leg) for leg in range(self.legs)) for n in range(knots)]
        heights = []
        for n in range(knots):
            force = [total(q.force[k] for leg in pieces[n] for q in leg) for k in range(3)]
            height = self.height(n, force)
            heights.append(height[0])
            self.dynamics(n, pieces[n], force, height[1])
            if task.least_contacts:
                standing = total(q.chosen for leg in pieces[n] for q in leg)
                self.model.add("gait.contacts", standing, task.least_contacts, self.legs)
        self.endurance(pieces)
        for n in range(knots - 1):
            for leg in range(self.legs):
                self.no_slip(n, pieces[n][leg], pieces[n + 1][leg])
        counts = self.costs(pieces)
        # Nothing dearer than what is known
        priced = {c: cost for c, cost in enumerate(self.model.cost) if cost}
        known = len(self.model)
        self.model.add("cost.known", Lin(priced), 0.0, self.cost - self.model.constant)
        states = [(*p[n], *v[n], *angles[n], *spin[n]) for n in range(knots + 1)]
        return Relaxation(
            self.model,
            tuple(pieces),
            tuple(heights),
            tuple(counts),
            self.unit,
            tuple(states),
            tuple(tuple(columns) for columns in self.aside),
            self.given,
            self.cost,
            np.array([[self.rows[n, leg] for leg in range(self.legs)] for n in range(knots)]),
            known,
            self.box,
            self.turned,
            tuple(self.paid),
            np.stack([t.facing for t in self.turns]),
        )
