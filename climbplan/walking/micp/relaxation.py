"""The mixed-integer linear relaxation of a walk (chapter 8.2.1), in reduced form.

    minimise    tracking of velocity, angles and height + motion + force differences    (8.30)
    subject to  forward Euler dynamics of a rigid body                        (8.14) - (8.19)
                each toe in its workspace box, seen from the body             (8.20), (8.21)
                no slip of standing legs                                              (8.22)
                no force on swinging legs, and their clearance                        (8.23)
                standing toes on their regions                                (8.24), (8.25)
                forces in their friction cones                                        (8.18)
                cost <= cutoff

Products are relaxed as follows. In the world frame the moment arm of a standing toe has
r_z = h - p_z for every leg, so that the eight products of r_z with forces are two, p_z F_x and
p_z F_y. Arms and the height of the body are partitioned, in perspective form: each piece has its
own binary, arm and force. The binaries of a leg sum to its contact (piecewise McCormick envelopes).
Products of an arm with f_z are McCormick envelopes. Those with f_x and f_y are rows of
(arm - end) (mu f_z +- f) >= 0, which vanish with the force. Arms and forces are about the heading
axes, rotated by the yaw of the middle of the attitude box, as toe boxes are narrowest about these.
Attitudes and angular velocities stay within the attitude box: products with the small rotation
from its middle are envelopes, and second-order terms are bounded remainders.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.micp.attitude_box import AttitudeBox
from climbplan.walking.micp.dynamics_rows import DynamicsRows
from climbplan.walking.micp.linear_model import LinearModel, LinExpr, sum_expressions
from climbplan.walking.micp.partitions import ArmPiece, HeightPartition
from climbplan.walking.micp.stance_count_rows import StanceCount
from climbplan.walking.micp.variable_bounds import VariableBounds
from climbplan.walking.task.task import POSITION, WalkTask, WalkTrajectory


@dataclass(frozen=True)
class MixedIntegerRelaxation:
    """The program, and where its variables are."""

    model: LinearModel
    pieces: tuple[tuple[tuple[ArmPiece, ...], ...], ...]  # by knot and leg
    height_partitions: tuple[HeightPartition, ...]  # by knot
    stance_counts: tuple[tuple[StanceCount, ...], ...]  # by knot
    force_unit: float  # [N]
    states: tuple[tuple[LinExpr, ...], ...]  # (N + 1) of 12 variables
    # Columns of the cost of velocities along x and along y, except at the last knot
    velocity_cost_columns: tuple[tuple[int, ...], ...]
    fixed_velocity_cost: Array  # (2,) cost of those velocities that are constants
    cutoff: float  # limit on the cost of motions
    contact_rows: IntArray  # (N, L) rows that bound the contact of each leg
    cutoff_row: int
    bounds: VariableBounds
    num_rotation_knots: int  # knots with rows of rotation
    stage_offsets: tuple[tuple[int, float], ...]  # (N) first column and constant of each cost
    heading_axes: Array  # (N, 3, 3) axes of arms and forces, as columns

    def build_tail_cost(self, first_knot: int) -> tuple[Array, float]:
        """Return the cost of all intervals from a knot on: by column (n,), and a constant."""
        first_column, constant = self.stage_offsets[first_knot]
        cost = np.array(self.model.cost)
        cost[:first_column] = 0.0
        return cost, self.model.constant - constant

    def evaluate_binaries(self, trajectory: WalkTrajectory) -> dict[int, float]:
        """Return the values of all binaries at a trajectory, by column."""
        values: dict[int, float] = {}
        contact, region = trajectory.gait.contact, trajectory.gait.region
        for n, legs in enumerate(self.pieces):
            arms = (trajectory.toes[n] - trajectory.state[n, POSITION]) @ self.heading_axes[n]
            for leg, pieces in enumerate(legs):
                on_region = [q for q in pieces if q.region == region[n, leg]]
                selected = min(
                    on_region, key=lambda q: q.compute_violation(arms[leg]), default=None
                )
                for q in pieces:
                    is_selected = contact[n, leg] and q is selected
                    values[q.indicator.column] = float(is_selected)
            height, partition = trajectory.state[n, 2], self.height_partitions[n]
            is_below = (partition.high >= height - 1e-9) | (partition.high == partition.high[-1])
            piece = int(np.argmax(is_below))
            for k, indicator in enumerate(partition.indicators):
                values[indicator.column] = float(k == piece)
            for count in self.stance_counts[n]:
                values[count.indicator.column] = float(contact[n].sum() == count.num_legs)
        return values

    def evaluate_point(self, trajectory: WalkTrajectory) -> dict[int, float]:
        """Return binaries, states and forces of a trajectory, by column; the rest are products."""
        values = self.evaluate_binaries(trajectory)
        for row, variables in zip(trajectory.state, self.states, strict=True):
            values |= {c.column: float(v) for c, v in zip(variables, row, strict=True)}
        for n, legs in enumerate(self.pieces):
            for leg, pieces in enumerate(legs):
                for q in pieces:
                    factor = values[q.indicator.column] / self.force_unit
                    force = trajectory.force[n, leg] @ self.heading_axes[n]
                    for variable, component in zip(q.force, force, strict=True):
                        values[variable.column] = float(factor * component)
        return values

    def evaluate_contacts(self, x: Array) -> Array:
        """Return the relaxed contacts (N, L) at a point (n,)."""
        return np.array(
            [
                [sum_expressions(q.indicator for q in leg).evaluate(x) for leg in legs]
                for legs in self.pieces
            ]
        )

    def round_gait(self, x: Array, threshold: float = 0.5) -> tuple[BoolArray, IntArray]:
        """Round the gait of a point.

        Args:
            x: The point (n,).
            threshold: Relaxed contacts above it are rounded to 1.

        Returns:
            Contacts and regions (N, L); the region of a swinging leg is -1.
        """
        contact = np.zeros((len(self.pieces), len(self.pieces[0])), bool)
        region = np.full((len(self.pieces), len(self.pieces[0])), -1, np.int64)
        for n, legs in enumerate(self.pieces):
            for leg, pieces in enumerate(legs):
                values = [piece.indicator.evaluate(x) for piece in pieces]
                if sum(values) > threshold:
                    largest = pieces[int(np.argmax(values))]
                    contact[n, leg], region[n, leg] = True, largest.region
        return contact, region


def build_relaxation(
    task: WalkTask,
    attitude_box: AttitudeBox,
    cutoff: float,
    arm_pieces: int,
    height_pieces: int,
    tangent_ratio: float,
    *,
    bounds: VariableBounds | None = None,
    constant_inertia: bool = False,
    num_rotation_knots: int | None = None,
) -> MixedIntegerRelaxation:
    """Build the relaxation of all motions within an attitude box and below a cutoff.

    Args:
        task: The task, whose dynamics are taken by forward Euler.
        attitude_box: Angles and angular velocities of the motions.
        cutoff: Limit on the cost of the motions.
        arm_pieces: Pieces of each moment arm.
        height_pieces: Pieces of the height of the body.
        tangent_ratio: Ratio of the points of tangency of squares.
        bounds: Bounds of the variables; None: nothing but the limits of the task is known.
        constant_inertia: Take the inertia at the middle of the attitude box: fewer columns.
        num_rotation_knots: Knots with rows of rotation, and later ones are translations only;
            None: all knots.

    Returns:
        The program and its variables.
    """
    return _RelaxationBuilder(
        task,
        attitude_box,
        cutoff,
        arm_pieces,
        height_pieces,
        tangent_ratio,
        bounds=bounds,
        constant_inertia=constant_inertia,
        num_rotation_knots=num_rotation_knots,
    ).build()


class _RelaxationBuilder(DynamicsRows):
    """The rows of the relaxation in their order."""

    def build(self) -> MixedIntegerRelaxation:
        """Add all rows after the states, and return the program."""
        task, knots, legs = self.task, self.task.knots, range(self.num_legs)
        pieces = [tuple(self.add_leg(n, leg) for leg in legs) for n in range(knots)]
        partitions = []
        for n in range(knots):
            force = [
                sum_expressions(q.force[k] for leg in pieces[n] for q in leg) for k in range(3)
            ]
            partition, height_products = self.add_height_products(n, force)
            partitions.append(partition)
            self.add_dynamics_rows(n, pieces[n], force, height_products)
            if task.min_contacts:
                contacts = sum_expressions(q.indicator for leg in pieces[n] for q in leg)
                self.model.add_constraint(
                    "gait.contacts", contacts, task.min_contacts, self.num_legs
                )
        self.add_stance_duration_rows(pieces)
        for n in range(knots - 1):
            for leg in legs:
                self.add_no_slip_rows(n, pieces[n][leg], pieces[n + 1][leg])
        counts = self.add_costs(pieces)
        total_cost = LinExpr({c: cost for c, cost in enumerate(self.model.cost) if cost})
        cutoff_row = len(self.model)
        self.model.add_constraint("cost.known", total_cost, 0.0, self.cutoff - self.model.constant)
        return MixedIntegerRelaxation(
            model=self.model,
            pieces=tuple(pieces),
            height_partitions=tuple(partitions),
            stance_counts=tuple(counts),
            force_unit=self.force_unit,
            states=tuple(
                (*self.p[n], *self.v[n], *self.angles[n], *self.omega[n]) for n in range(knots + 1)
            ),
            velocity_cost_columns=tuple(tuple(columns) for columns in self.velocity_cost_columns),
            fixed_velocity_cost=self.fixed_velocity_cost,
            cutoff=self.cutoff,
            contact_rows=np.array(
                [[self.contact_rows[n, leg] for leg in legs] for n in range(knots)]
            ),
            cutoff_row=cutoff_row,
            bounds=self.bounds,
            num_rotation_knots=self.num_rotation_knots,
            stage_offsets=tuple(self.stage_offsets),
            heading_axes=np.stack([rotation.heading_axes for rotation in self.rotations]),
        )
