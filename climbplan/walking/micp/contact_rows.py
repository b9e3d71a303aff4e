"""Rows of the legs: contact and swing, workspace, regions, friction, and no slip.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import itertools

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.linear_model import LinExpr, sum_expressions
from climbplan.walking.micp.partitions import ArmPiece
from climbplan.walking.micp.rotation_rows import RotationRows
from climbplan.walking.task.task import POSITION

FACETS = 8  # of the pyramid about a friction cone


class ContactRows(RotationRows):
    """Rows of each leg at each knot."""

    def add_leg(self, n: int, leg: int) -> tuple[ArmPiece, ...]:
        """Add variables and rows of a leg at a knot.

        They are workspace (8.20), (8.21), contact and swing (8.23), regions (8.24), and friction
        (8.18).

        Returns:
            The pieces of the arm; their indicators sum to the contact of the leg.
        """
        task, model = self.task, self.model
        level, heading_axes = task.ground.height, self.rotations[n].heading_axes
        start_arm = heading_axes.T @ (task.start.toes[leg] - task.start.state[POSITION])
        if n == 0:
            region = int(task.ground.nearest(task.start.toes[leg, :2]))
            ends = [(region, start_arm[:2], start_arm[:2])]
        else:
            low, high = self.find_arm_range(n, leg)
            arm_low = np.maximum(low[:2], self.bounds.arm_low[n, leg])
            arm_high = np.maximum(np.minimum(high[:2], self.bounds.arm_high[n, leg]), arm_low)
            knots = np.linspace(arm_low[0], arm_high[0], self.arm_pieces + 1)
            ends = [
                (s, np.array([a, arm_low[1]]), np.array([b, arm_high[1]]))
                for s in self.find_reachable_regions(n, leg, arm_low, arm_high)
                for a, b in itertools.pairwise(knots)
            ]
        forces = self.bounds.force_low[n, leg], self.bounds.force_high[n, leg]
        has_rotation = n < self.num_rotation_knots
        pieces = tuple(self.add_arm_piece(*end, forces, has_rotation) for end in ends)
        contact = sum_expressions(q.indicator for q in pieces)
        self.contact_rows[n, leg] = len(model)
        contact_low = float(self.bounds.contact_low[n, leg])
        contact_high = float(self.bounds.contact_high[n, leg])
        model.add_constraint("contact.region", contact, contact_low, contact_high)
        if n == 0:
            self.arms[n, leg] = (LinExpr(constant=start_arm[0]), LinExpr(constant=start_arm[1]))
            return pieces
        if contact_low > 0.0:  # the leg stands in every motion
            low, high = np.append(arm_low, low[2]), np.append(arm_high, high[2])
        arm = (model.add_variable(low[0], high[0]), model.add_variable(low[1], high[1]))
        self.arms[n, leg] = arm
        name = "contact.region"
        for k in range(2):
            standing_arm = sum_expressions(q.arm[k] for q in pieces)
            # The arm of a swinging leg is anywhere in reach.
            swing_arm = arm[k] - standing_arm
            model.add_constraint(name, swing_arm + contact * low[k], low[k], np.inf)
            model.add_constraint(name, swing_arm + contact * high[k], -np.inf, high[k])
        toe = self.add_toe_height(pieces, contact, level)
        if has_rotation:
            self.add_workspace_rows(n, leg, (arm[0], arm[1], toe - self.p[n][2]))
        for q in pieces:
            self.add_region_rows(n, q, arm)
        return pieces

    def add_toe_height(
        self, pieces: tuple[ArmPiece, ...], contact: LinExpr, level: Array
    ) -> LinExpr:
        """Add the height of a toe: that of its region, or one between lowest and highest lift."""
        model, clearance = self.model, self.task.swing_clearance
        height = sum_expressions(q.indicator * float(level[q.region]) for q in pieces)
        highest = self.task.ground.max_swept_height
        low, high = float(level.min() + clearance), float(highest + clearance)
        toe = model.add_variable(level.min(), high)
        model.add_constraint("swing.clearance", toe - height + contact * low, low, np.inf)
        model.add_constraint("swing.clearance", toe - height + contact * high, -np.inf, high)
        return toe

    def add_workspace_rows(self, n: int, leg: int, arm: tuple[LinExpr, LinExpr, LinExpr]) -> None:
        """Add rows that keep a toe in its box in the body frame.

        Args:
            n: The knot.
            leg: The leg.
            arm: The toe from the body (3,), about the heading axes.
        """
        model, rotation, name = self.model, self.rotations[n], "workspace.toe"
        center, half = self.task.body.toe_center[leg], self.task.body.toe_half
        low, high = rotation.middle_arm_low[leg].copy(), rotation.middle_arm_high[leg].copy()
        ends, R = [self.compute_interval(r) for r in arm], rotation.heading_axes.T @ rotation.R
        middle = [sum_expressions(arm[j] * float(R[j, k]) for j in range(3)) for k in range(3)]
        for k in range(3):
            corners = [sorted(float(R[j, k]) * e for e in ends[j]) for j in range(3)]
            low[k] = max(low[k], sum(c[0] for c in corners))
            high[k] = min(high[k], sum(c[1] for c in corners))
            model.add_constraint(name, middle[k], low[k], high[k])
        in_body = self.rotate_to_body(name, n, middle, low, high)
        lower = center - half - rotation.toe_remainder_high[leg]
        upper = center + half - rotation.toe_remainder_low[leg]
        for k in range(3):
            model.add_constraint(name, in_body[k], float(lower[k]), float(upper[k]))

    def add_arm_piece(
        self, region: int, low: Array, high: Array, forces: tuple[Array, Array], has_products: bool
    ) -> ArmPiece:
        """Add the variables and rows of one piece of an arm.

        Args:
            region: The region that the leg stands on.
            low: Lower end of the arm (2,), about the heading axes [m].
            high: Upper end of the arm (2,) [m].
            forces: Lower and upper bound of the force (3,), in the force unit.
            has_products: Whether to add the products of arm and force.
        """
        model, friction = self.model, self.task.ground.friction
        indicator = model.add_variable(0.0, 1.0, is_integer=True)
        arm = (
            self.add_switched_variable("contact.region", indicator, float(low[0]), float(high[0])),
            self.add_switched_variable("contact.region", indicator, float(low[1]), float(high[1])),
        )
        force_low, force_high = forces
        x, y, z = (
            self.add_switched_variable("force.without_contact", indicator, a, b)
            for a, b in zip(force_low, force_high, strict=True)
        )
        force = (x, y, z)
        for k in range(FACETS):
            angle = 2 * np.pi * k / FACETS
            tangential = force[0] * float(np.cos(angle)) + force[1] * float(np.sin(angle))
            model.add_nonnegative("force.friction", force[2] * friction - tangential)
        products = []
        for k in range(2):
            if not has_products:
                products.append((LinExpr(), LinExpr()))
                continue
            arm_range = float(low[k]), float(high[k])
            normal_range = float(force_low[2]), float(force_high[2])
            with_normal = self.add_switched_product(arm[k], arm_range, z, normal_range, indicator)
            with_tangential = self.add_friction_product(
                arm_range, force[1 - k], z, with_normal, friction
            )
            if self.has_tight_bounds and high[k] - low[k] > 1e-12:
                force_range = float(force_low[1 - k]), float(force_high[1 - k])
                self.add_mccormick_rows(
                    with_tangential, arm[k], arm_range, force[1 - k], force_range, indicator
                )
            products.append((with_tangential, with_normal))
        return ArmPiece(region, low, high, indicator, arm, force, products[0], products[1])

    def find_reachable_regions(
        self, n: int, leg: int, arm_low: Array, arm_high: Array
    ) -> list[int]:
        """Return a leg's own regions that its toe with an arm (2,) in this range can be on."""
        ground, axes = self.task.ground, self.rotations[n].heading_axes[:2, :2]
        middle = axes @ (0.5 * (arm_low + arm_high)[:2])
        half = np.abs(axes) @ (0.5 * (arm_high - arm_low)[:2])
        low, high = self.p_low[n, :2] + middle - half, self.p_high[n, :2] + middle + half
        regions = ground.list_regions(leg)
        is_below = (ground.lower[regions] <= high).all(axis=1)
        is_reachable = is_below & (ground.upper[regions] >= low).all(axis=1)
        return [int(s) for s in regions[is_reachable]]

    def add_region_rows(self, n: int, piece: ArmPiece, arm: tuple[LinExpr, LinExpr]) -> None:
        """Add rows that keep the toe on the region of a piece if that is selected (big-M)."""
        ground, name = self.task.ground, "contact.region"
        if len(ground.height) == 1:
            return
        toes, lows, highs = [], [], []
        for k, offset in enumerate(self.rotate_to_world(n, arm)):
            toe, ends = offset + self.p[n][k], self.compute_interval(offset)
            lowest = self.p_low[n, k] + min(ends[0], 0.0)
            highest = self.p_high[n, k] + max(ends[1], 0.0)
            toes.append(toe)
            lows.append(lowest)
            highs.append(highest)
            low, high = float(ground.lower[piece.region, k]), float(ground.upper[piece.region, k])
            if lowest < low:
                self.model.add_nonnegative(name, toe - lowest - piece.indicator * (low - lowest))
            if highest > high:
                self.model.add_nonnegative(name, highest - toe - piece.indicator * (highest - high))
        for a, b, bound in ground.sides[piece.region].tolist():  # of polygons
            furthest = sum(
                max(factor * low, factor * high)
                for factor, low, high in zip((a, b), lows, highs, strict=True)
            )
            if furthest > bound:
                row = piece.indicator * (furthest - bound)
                self.model.add_nonnegative(name, furthest - toes[0] * a - toes[1] * b - row)

    def add_no_slip_rows(
        self, n: int, current: tuple[ArmPiece, ...], following: tuple[ArmPiece, ...]
    ) -> None:
        """Add no slip from a knot to the next, eq. (8.22), as the convex hull of its disjunction.

        Either the leg stands at both knots and its arm changes by -v dt, or it does not. The hull
        is tighter than rows with a big M.

        Args:
            n: The knot.
            current: Pieces of the leg at the knot.
            following: Pieces of the leg at the next knot.
        """
        model, dt, name = self.model, self.task.dt, "contact.no_slip"
        contact = sum_expressions(q.indicator for q in current)
        next_contact = sum_expressions(q.indicator for q in following)
        stays = model.add_variable(0.0, 1.0)  # the leg stands at both knots
        model.add_nonnegative(name, contact - stays)
        model.add_nonnegative(name, next_contact - stays)
        model.add_nonnegative(name, stays - contact - next_contact + 1.0)
        arms: list[tuple[LinExpr, LinExpr]] = []
        for knot, pieces, standing in ((n, current, contact), (n + 1, following, next_contact)):
            staying_arm = []
            for k in range(2):
                low = min(float(q.low[k]) for q in pieces)
                high = max(float(q.high[k]) for q in pieces)
                arm = self.add_switched_variable(name, stays, low, high)
                other_arm = sum_expressions(q.arm[k] for q in pieces) - arm
                model.add_nonnegative(name, other_arm - (standing - stays) * low)
                model.add_nonnegative(name, (standing - stays) * high - other_arm)
                staying_arm.append(arm)
            arms.append(self.rotate_to_world(knot, staying_arm))
        for k in range(2):
            low, high = float(self.v_low[n, k]), float(self.v_high[n, k])
            velocity = self.add_switched_variable(name, stays, low, high)
            other_velocity = self.v[n][k] - velocity
            model.add_nonnegative(name, other_velocity - (1.0 - stays) * low)
            model.add_nonnegative(name, (1.0 - stays) * high - other_velocity)
            model.add_constraint(name, arms[1][k] - arms[0][k] + velocity * dt, 0.0, 0.0)

    def add_stance_duration_rows(self, pieces: list[tuple[tuple[ArmPiece, ...], ...]]) -> None:
        """Add valid inequalities: no leg stands while the body moves it out of its reach.

        Args:
            pieces: The pieces of all arms, by knot and leg.
        """
        knots, start = self.task.knots, self.task.start
        reach = [
            [(r.world_arm_low[leg], r.world_arm_high[leg]) for leg in range(self.num_legs)]
            for r in self.rotations
        ]
        for leg in range(self.num_legs):
            start_arm = start.toes[leg] - start.state[POSITION]
            reach[0][leg] = (start_arm, start_arm)
            contacts = [sum_expressions(q.indicator for q in pieces[n][leg]) for n in range(knots)]
            for n in range(knots):
                for last in range(n + 1, knots):
                    min_displacement, max_displacement = self.bound_displacement(n, last)
                    # The arm changes by minus the displacement of the body.
                    low = reach[n][leg][0][:2] - reach[last][leg][1][:2]
                    high = reach[n][leg][1][:2] - reach[last][leg][0][:2]
                    if (min_displacement > high + 1e-9).any() or (
                        max_displacement < low - 1e-9
                    ).any():
                        self.model.add_constraint(
                            "contact.endurance",
                            sum_expressions(contacts[n : last + 1]),
                            -np.inf,
                            float(last - n),
                        )
                        break
