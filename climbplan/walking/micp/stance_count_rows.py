"""The convex hull over the number of standing legs: vertical forces and velocities of each number.

With relaxed contacts alone a body could stand on a fraction of every leg at once: no two forces
would differ, and it would never fall. Each knot therefore has a binary for each number of standing
legs, with a vertical force and velocities of its own, and squares in perspective form (a
disjunctive formulation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.robots.leg_order import contrasts
from climbplan.walking.micp.contact_rows import ContactRows
from climbplan.walking.micp.linear_model import LinExpr, sum_expressions
from climbplan.walking.micp.partitions import ArmPiece


@dataclass(frozen=True)
class StanceCount:
    """One number of standing legs at a knot: its binary, and what is zero unless it is selected."""

    num_legs: int
    indicator: LinExpr
    force: LinExpr  # vertical, in the force unit
    velocity_before: LinExpr  # vertical, at the knot
    velocity_after: LinExpr  # and at the next one


class StanceCountRows(ContactRows):
    """Rows and squares of each knot by the number of standing legs."""

    def add_stance_counts(
        self, n: int, legs: tuple[tuple[ArmPiece, ...], ...]
    ) -> tuple[StanceCount, ...]:
        """Add all numbers of legs that may stand at a knot, and the rows that sum them up."""
        model, bounds, name = self.model, self.bounds, "gait.contacts"
        min_legs = max(self.task.min_contacts, round(bounds.contact_low[n].sum()))
        max_legs = round(bounds.contact_high[n].sum())
        counts = tuple(self.add_stance_count(n, m) for m in range(min_legs, max_legs + 1))
        contacts = [sum_expressions(q.indicator for q in leg) for leg in legs]
        model.add_constraint(name, sum_expressions(c.indicator for c in counts), 1.0, 1.0)
        standing = sum_expressions(c.indicator * float(c.num_legs) for c in counts)
        model.add_constraint(name, standing - sum_expressions(contacts), 0.0, 0.0)
        for contact in contacts:
            if max_legs == self.num_legs and min_legs <= max_legs:
                model.add_nonnegative(name, contact - counts[-1].indicator)
            if min_legs == 0 and min_legs <= max_legs:
                model.add_nonnegative(name, 1.0 - contact - counts[0].indicator)
        force = sum_expressions(q.force[2] for leg in legs for q in leg)
        model.add_constraint(name, sum_expressions(c.force for c in counts) - force, 0.0, 0.0)
        velocity = sum_expressions(c.velocity_before for c in counts)
        model.add_constraint(name, velocity - self.v[n][2], 0.0, 0.0)
        return counts

    def add_stance_count(self, n: int, num_legs: int) -> StanceCount:
        """Add one number of standing legs at a knot, with its vertical force and velocities."""
        task, model, name = self.task, self.model, "dynamics.velocity"
        indicator = model.add_variable(0.0, 1.0, is_integer=True)
        max_force = num_legs * self.max_force
        force = self.add_switched_variable("force.limit", indicator, 0.0, max_force)
        low, high = float(self.v_low[n, 2]), float(self.v_high[n, 2])
        before = self.add_switched_variable(name, indicator, low, high)
        gain = task.dt * self.force_unit / task.body.mass
        after = before + force * gain - indicator * (task.dt * task.body.gravity)
        model.add_nonnegative(name, after - indicator * float(self.v_low[n + 1, 2]))
        model.add_nonnegative(name, indicator * float(self.v_high[n + 1, 2]) - after)
        return StanceCount(num_legs, indicator, force, before, after)

    def add_velocity_cost(
        self, n: int, arriving: tuple[StanceCount, ...], leaving: tuple[StanceCount, ...]
    ) -> None:
        """Add the cost of the velocity at a knot: its tracking error, and the step that it makes.

        The vertical part is at least that by the numbers of legs before the knot, and at least that
        by those after it.

        Args:
            n: The knot, at least 1.
            arriving: Numbers of legs that stand before the knot.
            leaving: Numbers of legs that stand from the knot on; none at the last knot.
        """
        task, model, w = self.task, self.model, self.task.weights
        motion = w.motion * task.dt**2 if n < task.knots else 0.0
        for k in range(3):
            tracking, reference = float(w.velocity[k]), float(task.reference.velocity[n - 1, k])
            weight = tracking + motion
            if weight == 0.0:
                continue
            middle = tracking * reference / weight  # the cheapest velocity
            model.constant += tracking * reference**2 - weight * middle**2
            ends = float(self.v_low[n, k]) - middle, float(self.v_high[n, k]) - middle
            if k < 2:
                square = self.add_cost_square("cost.tracking", weight, self.v[n][k] - middle, ends)
                if n < task.knots and square.terms:
                    self.velocity_cost_columns[k].append(square.column)
                elif n < task.knots:
                    self.fixed_velocity_cost[k] += square.constant
                continue
            cost = model.add_variable(0.0, model.max_square_cost, cost=1.0)
            for velocities in (
                [(c.velocity_after, c) for c in arriving],
                [(c.velocity_before, c) for c in leaving],
            ):
                squares = [
                    self.add_cost_square(
                        "cost.tracking",
                        weight,
                        velocity - c.indicator * middle,
                        ends,
                        c.indicator,
                        cost=0.0,
                    )
                    for velocity, c in velocities
                ]
                model.add_nonnegative("cost.tracking", cost - sum_expressions(squares))

    def add_force_difference_cost(
        self, legs: tuple[tuple[ArmPiece, ...], ...], counts: tuple[StanceCount, ...]
    ) -> None:
        """Add the cost of differences between forces of legs.

        Squares over ordered pairs of L legs are 2 L times those of L - 1 orthonormal contrasts. A
        total force F on m legs costs at least 2 (L / m - 1) F^2.

        Args:
            legs: Pieces of all arms at the knot, by leg.
            counts: Numbers of standing legs at the knot.
        """
        model, name = self.model, "cost.force_difference"
        weight = self.task.weights.force_difference * self.force_unit**2
        if weight == 0.0:
            return
        vertical = []
        for k in range(3):
            forces = [sum_expressions(q.force[k] for q in leg) for leg in legs]
            for signs in contrasts(self.num_legs):
                contrast = sum_expressions(f * float(s) for f, s in zip(forces, signs, strict=True))
                cost = 0.0 if k == 2 else 1.0
                square = self.add_cost_square(
                    name, 2.0 * self.num_legs * weight, contrast, cost=cost
                )
                if k == 2:
                    vertical.append(square)
        vertical_cost = model.add_variable(0.0, model.max_square_cost, cost=1.0)
        by_count = [
            self.add_cost_square(
                name,
                2.0 * (self.num_legs / c.num_legs - 1.0) * weight,
                c.force,
                (0.0, c.num_legs * self.max_force),
                c.indicator,
                cost=0.0,
            )
            for c in counts
            if 0 < c.num_legs < self.num_legs
        ]
        model.add_nonnegative(name, vertical_cost - sum_expressions(vertical))
        model.add_nonnegative(name, vertical_cost - sum_expressions(by_count))

    def add_cost_square(
        self,
        name: str,
        weight: float,
        value: LinExpr,
        value_range: tuple[float, float] | None = None,
        indicator: LinExpr | None = None,
        cost: float = 1.0,
    ) -> LinExpr:
        """Add a square to the model, with tangents up to where it alone costs the cutoff.

        Args:
            name: Name of the block of tangents.
            weight: Weight of the square.
            value: The expression that is squared.
            value_range: Its range for an indicator of 1; None: by interval arithmetic.
            indicator: Relaxed binary that the value vanishes with; None: 1.
            cost: Coefficient of the square in the cost.

        Returns:
            The epigraph variable, a lower bound on the square.
        """
        model = self.model
        if indicator is None and all(model.lower[c] == model.upper[c] for c in value.terms):
            fixed = sum(f * model.lower[c] for c, f in value.terms.items())
            value = LinExpr(constant=value.constant + fixed)
        low, high = value_range if value_range is not None else self.compute_interval(value)
        max_value = float(np.sqrt(self.cutoff / max(weight, 1e-12)))
        low, high = max(low, -max_value), min(high, max_value)
        return model.add_square(
            name, weight, value, (low, high), self.tangent_ratio, indicator=indicator, cost=cost
        )
