"""Rows of the body: moments by its height, dynamics of position and rotation, and the cost.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import itertools

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.linear_model import LinExpr, sum_expressions
from climbplan.walking.micp.partitions import ArmPiece, HeightPartition
from climbplan.walking.micp.stance_count_rows import StanceCount, StanceCountRows
from climbplan.walking.task.task import VELOCITY

_NEXT_AXIS, _LAST_AXIS = (1, 2, 0), (2, 0, 1)  # of a cross product


class DynamicsRows(StanceCountRows):
    """Rows of the body from each knot to the next, and the squares of the cost."""

    def add_height_products(
        self, n: int, force: list[LinExpr]
    ) -> tuple[HeightPartition, tuple[LinExpr, LinExpr]]:
        """Add the products of the height with the total force, eq. (8.26) on pieces of the height.

        Args:
            n: The knot.
            force: The total force (3,), about the heading axes.

        Returns:
            The pieces of the height, and p_z F_x and p_z F_y.
        """
        model, name = self.model, "dynamics.angular_velocity"
        low, high = float(self.p_low[n, 2]), float(self.p_high[n, 2])
        if n >= self.num_rotation_knots:
            indicators: tuple[LinExpr, ...] = (model.add_variable(1.0, 1.0),)
            partition = HeightPartition(np.array([low]), np.array([high]), indicators)
            return partition, (LinExpr(), LinExpr())
        count = self.height_pieces if high - low > 1e-9 else 1
        knots = np.linspace(low, high, count + 1)
        indicators, heights = (), []
        sums: tuple[list[LinExpr], ...] = ([], [], [])
        products: tuple[list[LinExpr], list[LinExpr]] = ([], [])
        friction = self.task.ground.friction
        force_low, force_high = self.bounds.total_force_low[n], self.bounds.total_force_high[n]
        ranges = [(float(a), float(b)) for a, b in zip(force_low, force_high, strict=True)]
        for a, b in itertools.pairwise(knots):
            indicator = model.add_variable(1.0 if count == 1 else 0.0, 1.0, is_integer=count > 1)
            z = self.add_switched_variable(name, indicator, a, b)
            ends = float(a), float(b)
            f = [self.add_switched_variable("force.limit", indicator, *range_) for range_ in ranges]
            with_normal = self.add_switched_product(z, ends, f[2], ranges[2], indicator)
            for k in range(2):
                product = self.add_friction_product(ends, f[k], f[2], with_normal, friction)
                if self.has_tight_bounds and b - a > 1e-12:
                    self.add_mccormick_rows(product, z, ends, f[k], ranges[k], indicator)
                products[k].append(product)
                model.add_nonnegative("force.friction", f[2] * friction - f[k])
                model.add_nonnegative("force.friction", f[2] * friction + f[k])
            indicators += (indicator,)
            heights.append(z)
            for k in range(3):
                sums[k].append(f[k])
        model.add_constraint(name, sum_expressions(indicators), 1.0, 1.0)
        model.add_constraint(name, sum_expressions(heights) - self.p[n][2], 0.0, 0.0)
        for k in range(3):
            model.add_constraint(name, sum_expressions(sums[k]) - force[k], 0.0, 0.0)
        partition = HeightPartition(knots[:-1], knots[1:], indicators)
        return partition, (sum_expressions(products[0]), sum_expressions(products[1]))

    def add_dynamics_rows(
        self,
        n: int,
        legs: tuple[tuple[ArmPiece, ...], ...],
        force: list[LinExpr],
        height_products: tuple[LinExpr, LinExpr],
    ) -> None:
        """Add the dynamics from a knot to the next, eqs. (8.14) to (8.17) and (8.19).

        Args:
            n: The knot.
            legs: Pieces of all arms at the knot, by leg.
            force: The total force (3,), about the heading axes.
            height_products: p_z F_x and p_z F_y.
        """
        task, model, dt = self.task, self.model, self.task.dt
        world_force = (*self.rotate_to_world(n, force), force[2])
        for k in range(3):
            model.add_constraint(
                "dynamics.position", self.p[n + 1][k] - self.p[n][k] - self.v[n][k] * dt, 0.0, 0.0
            )
            fall = dt * task.body.gravity if k == 2 else 0.0
            gain = world_force[k] * (dt * self.force_unit / task.body.mass)
            model.add_constraint(
                "dynamics.velocity", self.v[n + 1][k] - self.v[n][k] - gain + fall, 0.0, 0.0
            )
        if n < self.num_rotation_knots:
            moment = self.build_moment(n, legs, height_products)
            self.add_rotation_dynamics(n, moment, self.build_max_moment(n, legs))

    def build_moment(
        self,
        n: int,
        legs: tuple[tuple[ArmPiece, ...], ...],
        height_products: tuple[LinExpr, LinExpr],
    ) -> list[LinExpr]:
        """Return the moment (3,) of all forces about the body, world frame, in force units."""
        level = self.task.ground.height
        pieces = [q for leg in legs for q in leg]
        moment = [
            sum_expressions(q.products_y[1] - q.force[1] * float(level[q.region]) for q in pieces)
            + height_products[1],
            sum_expressions(q.force[0] * float(level[q.region]) - q.products_x[1] for q in pieces)
            - height_products[0],
            sum_expressions(q.products_x[0] - q.products_y[0] for q in pieces),
        ]
        return [*self.rotate_to_world(n, moment), moment[2]]

    def build_max_moment(self, n: int, legs: tuple[tuple[ArmPiece, ...], ...]) -> list[LinExpr]:
        """Return an upper bound on the size of the moment (3,): arms times forces in the cone."""
        rotation, friction = self.rotations[n], self.task.ground.friction
        reach = np.maximum(np.abs(rotation.world_arm_low), np.abs(rotation.world_arm_high))
        max_moment = []
        for a, b in ((1, 2), (0, 2), (0, 1)):
            terms = []
            for leg in range(self.num_legs):
                arm = reach[leg]
                lever = arm[a] + friction * arm[b] if b == 2 else friction * (arm[a] + arm[b])
                terms += [q.force[2] * float(lever) for q in legs[leg]]
            max_moment.append(sum_expressions(terms))
        return max_moment

    def add_rotation_dynamics(
        self, n: int, moment: list[LinExpr], max_moment: list[LinExpr]
    ) -> None:
        """Add rows of angles and angular velocities at the next knot, eqs. (8.15) and (8.17).

        Args:
            n: The knot.
            moment: Moment of the contact forces (3,), world frame, in force units.
            max_moment: Upper bound on its size (3,).
        """
        task, model, dt, rotation = self.task, self.model, self.task.dt, self.rotations[n]
        self.add_attitude_rows(n)
        gyro, max_gyro = self.add_gyroscopic_moment(n)
        # The principal axes are seen in the world frame from the middle of the attitude box.
        axes = rotation.R @ rotation.principal_axes
        axes_error = rotation.R_error @ np.abs(rotation.principal_axes)
        inertia = rotation.principal_moments
        for k in range(3):
            by_forces = sum_expressions(
                moment[j] * float(rotation.inverse_inertia[k, j] * self.force_unit)
                for j in range(3)
            )
            by_gyro = sum_expressions(gyro[j] * float(axes[k, j] / inertia[j]) for j in range(3))
            change = self.omega[n + 1][k] - self.omega[n][k] - (by_forces + by_gyro) * dt
            slack = sum_expressions(
                max_moment[j] * float(rotation.inverse_inertia_error[k, j] * self.force_unit)
                for j in range(3)
            )
            slack = (slack + float(axes_error[k] @ (max_gyro / inertia))) * dt
            model.add_nonnegative("dynamics.angular_velocity", change + slack)
            model.add_nonnegative("dynamics.angular_velocity", slack - change)

        if n + 1 < task.knots and self.constant_inertia:
            world_gyro = [
                sum_expressions(gyro[j] * float(axes[k, j]) for j in range(3)) for k in range(3)
            ]
            self.add_constant_inertia_rows(n, moment, world_gyro, axes_error @ max_gyro)
        elif n + 1 < task.knots:
            self.add_rotated_inertia_rows(n, moment, gyro, max_gyro)

    def add_constant_inertia_rows(
        self, n: int, moment: list[LinExpr], gyro: list[LinExpr], gyro_error: Array
    ) -> None:
        """Add Euler's equation (8.15) times the inertia at the middle of the attitude box.

        The error |I - I_middle| is multiplied with the largest accelerations. These are small
        compared with the largest moments, which the rows of the inverse inertia have to allow for.

        Args:
            n: The knot.
            moment: Moment of the contact forces (3,), world frame, in force units.
            gyro: Gyroscopic moment (3,), world frame.
            gyro_error: Error of the gyroscopic moment (3,).
        """
        dt, rotation = self.task.dt, self.rotations[n]
        change = [self.omega[n + 1][j] - self.omega[n][j] for j in range(3)]
        max_acceleration = np.array(
            [max(map(abs, self.compute_interval(component))) / dt for component in change]
        )
        slack = rotation.inertia_error @ max_acceleration + gyro_error
        for k in range(3):
            inertial = sum_expressions(
                change[j] * float(rotation.inertia[k, j] / dt) for j in range(3)
            )
            residual = inertial - moment[k] * self.force_unit - gyro[k]
            self.model.add_constraint(
                "dynamics.angular_velocity", residual, -float(slack[k]), float(slack[k])
            )

    def add_rotated_inertia_rows(
        self, n: int, moment: list[LinExpr], gyro: list[LinExpr], max_gyro: Array
    ) -> None:
        """Add Euler's equation (8.15) times the inertia, about the principal axes at the middle.

        Q I Q^T a = m + Q g with accelerations a, moments m, the rotation Q from the middle, and the
        gyroscopic moment g about the body's own axes. To first order Q is 1 + [w]. In [w] I - I [w]
        the rotation w multiplies differences of principal moments, one expression for each pair of
        axes. Second-order terms are multiplied with the largest accelerations, not with the far
        larger moments.

        Args:
            n: The knot.
            moment: Moment of the contact forces (3,), world frame, in force units.
            gyro: Gyroscopic moment (3,), about the principal axes.
            max_gyro: Upper bound on its size (3,).
        """
        rotation, name = self.rotations[n], "dynamics.angular_velocity"
        axes = rotation.R @ rotation.principal_axes
        change = [
            (self.omega[n + 1][j] - self.omega[n][j]) * (1.0 / self.task.dt) for j in range(3)
        ]
        a = [sum_expressions(change[j] * float(axes[j, k]) for j in range(3)) for k in range(3)]
        turn, max_turn = self.build_principal_rotation(n)
        ends = np.array([self.compute_interval(component) for component in a])
        inertia = rotation.principal_moments
        for i in range(3):
            residual = a[i] * float(inertia[i]) - gyro[i]
            pairs = (
                (_NEXT_AXIS[i], _LAST_AXIS[i], -1.0),
                (_LAST_AXIS[i], _NEXT_AXIS[i], 1.0),
            )
            for j, k, sign in pairs:
                difference = float(inertia[j] - inertia[i])
                z = a[j] * difference - gyro[j]
                low = float((difference * ends[j]).min() - max_gyro[j])
                high = float((difference * ends[j]).max() + max_gyro[j])
                product = self.add_envelope(name, turn[k], float(max_turn[k]), z, low, high)
                residual = residual + product * sign
            by_forces = sum_expressions(
                moment[j] * float(axes[j, i] * self.force_unit) for j in range(3)
            )
            inertial = [
                b * e
                for b in (rotation.inertia_remainder_low[i], rotation.inertia_remainder_high[i])
                for e in ends.T
            ]
            gyroscopic = [
                b * e
                for b in (rotation.rotation_remainder_low[i], rotation.rotation_remainder_high[i])
                for e in (-max_gyro, max_gyro)
            ]
            lower = -np.max(inertial, axis=0).sum() + np.min(gyroscopic, axis=0).sum()
            upper = -np.min(inertial, axis=0).sum() + np.max(gyroscopic, axis=0).sum()
            self.model.add_constraint(name, residual - by_forces, float(lower), float(upper))

    def add_costs(
        self, pieces: list[tuple[tuple[ArmPiece, ...], ...]]
    ) -> list[tuple[StanceCount, ...]]:
        """Add the objective, eq. (8.30), interval by interval.

        Args:
            pieces: Pieces of all arms, by knot and leg.

        Returns:
            The numbers of standing legs, by knot.
        """
        task, w = self.task, self.task.weights
        first_step = task.start.state[VELOCITY] * task.dt
        self.model.constant += w.motion * float(first_step @ first_step)
        counts = [self.add_stance_counts(n, legs) for n, legs in enumerate(pieces)]
        for n, legs in enumerate(pieces):
            self.stage_offsets.append((len(self.model.lower), self.model.constant))
            self.add_velocity_cost(n + 1, counts[n], counts[n + 1] if n + 1 < task.knots else ())
            self.add_force_difference_cost(legs, counts[n])
            for k in range(3):
                error = self.angles[n + 1][k] - float(task.reference.euler[n, k])
                self.add_cost_square("cost.tracking", float(w.angles[k]), error)
            self.add_cost_square(
                "cost.tracking", w.height, self.p[n + 1][2] - float(task.reference.height[n])
            )
        return counts
