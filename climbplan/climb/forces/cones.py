"""One instant's exact constraints on the forces themselves, as a conic program.

The plan itself is made on the reduced form. Here forces stay variables, so that a load, a friction
coefficient or a torque limit can be a variable as well. Forces are in units of the load.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.clarabel import build_clarabel_settings, solve_with_clarabel
from climbplan.climb.forces.lazy_constraints import build_stability_cone
from climbplan.climb.forces.statement import ForceStatement
from climbplan.mechanics.equilibrium import grasp_matrix
from climbplan.mechanics.friction import contact_frame

# Of constraints, as the check of forces, postures or statics has them
ConstraintName = Literal[
    "force.friction",
    "torque.limit",
    "force.unilateral",
    "force.penetration",
    "kinematics.joint_bounds",
    "static.stability",
]
_FAILURE_STATUSES = ("NumericalError", "InsufficientProgress", "MaxIterations")
_DIFF_ENDS: tuple[dict[str, Any], ...] = ({"prepend": -1}, {"append": -1})  # of points by limb
FEASIBLE = 1e-7  # violation, in units of the load and of the torque limits, that counts as none


@dataclass(frozen=True)
class InstantCones:
    """Constraints of one instant with l limbs in contact, at n points in all."""

    limb: IntArray  # (l,)
    limb_of: IntArray  # (n,) of each point its limb's place among these
    grasp: Array  # (6, 3 n) moments divided by the lever arm scale
    load: Array  # (6,) likewise
    axes: Array  # (n, 3, 3) rows normal, tangent, bitangent
    mu: Array  # (n,)
    safety_friction: float
    torque: Array  # (l, J, 3 n) torque / limit from forces
    link_torque_ratio: Array  # (l, J) torque / limit of the links' own weight
    max_s: float
    min_normal_force: float  # of every contact
    reserve: float  # pressure that each may miss before it slips
    penetration_per_force: (
        Array  # (l or 0, 3 n) depth of commanded toes inside their surfaces by forces [m]
    )
    min_penetration: Array  # (l or 0,) of these [m]
    deflection_per_force: Array  # (l, J, 3 n) joint angles less commands by forces [rad]
    command_margin: Array  # (l, J, 2) for commands below and above the joint angles [rad]
    stiffness_loss: Array  # (21 or 0, 3 n) triangle of the stiffness lost by forces
    max_stiffness_loss: Array  # (21 or 0,) of what they may take at most

    @property
    def num_contacts(self) -> int:
        """Return the number n of points in contact."""
        return len(self.limb_of)

    @property
    def num_joints(self) -> int:
        """Return the number J of joints of a limb."""
        return self.torque.shape[1]

    def with_friction(self, factor: float) -> InstantCones:
        """Return the same instant with all friction coefficients scaled."""
        return replace(self, mu=self.mu * factor)


def build_instant_cones(statement: ForceStatement, k: int) -> InstantCones:
    """Return the constraints of instant k."""
    limb, point = np.flatnonzero(statement.standing[k]), np.flatnonzero(statement.contact[k])
    limb_of = np.repeat(np.arange(len(limb)), statement.points)
    scale = np.array([1.0] * 3 + [1 / statement.length] * 3)
    bending = statement.deflection_per_force[k][limb][:, :, point].reshape(
        len(limb), -1, 3 * len(point)
    )
    min_penetration = statement.min_penetration[k, limb]
    bounded_limbs = limb if (min_penetration > -np.inf).all() else limb[:0]
    inward = statement.penetration_per_force[k][bounded_limbs][:, point].reshape(
        len(bounded_limbs), 3 * len(point)
    )
    stability = build_stability_cone(statement, np.array([k]))
    lost = stability.A[0][:, point].reshape(-1, 3 * len(point))
    torque_per_force = statement.torque_per_force[k, point] * statement.unit  # (n, J, 3)
    torque = np.zeros((len(limb), torque_per_force.shape[1], len(point), 3))
    torque[limb_of, :, np.arange(len(point))] = torque_per_force
    return InstantCones(
        limb=limb,
        limb_of=limb_of,
        grasp=grasp_matrix(statement.arms[k, point]) * scale[:, None],
        load=statement.load[k] * scale / statement.unit,
        axes=contact_frame(statement.normal[k, point]).axes,
        mu=statement.mu[k, point],
        safety_friction=statement.safety_friction,
        torque=torque.reshape(*torque.shape[:2], -1),
        link_torque_ratio=statement.link_torque_ratio[k, limb],
        max_s=float(statement.max_s[k]),
        min_normal_force=float(statement.min_normal_force[k]) / statement.unit,
        reserve=float(statement.reserve[k]) / statement.unit,
        penetration_per_force=inward * statement.unit,
        min_penetration=min_penetration[: len(bounded_limbs)],
        deflection_per_force=bending * statement.unit,
        command_margin=np.stack(
            [statement.margin_below[k, limb], statement.margin_above[k, limb]], axis=-1
        ),
        stiffness_loss=lost * statement.unit,
        max_stiffness_loss=stability.upper[0],
    )


@dataclass(frozen=True)
class ConicAnswer:
    """Optimum of a conic program."""

    x: Array
    value: float
    multipliers: dict[str, Array]  # by block


@dataclass
class ConicProgram:
    """Minimise cost . x over named blocks b - A x in a cone, built block by block.

    A name is that of the check that judges the constraint, with limb and joint where it has several
    blocks: `torque.limit.2`.
    """

    size: int
    blocks: list[tuple[str, Any, Array, Array]] = field(default_factory=list)

    def add_equality(self, name: str, A: Array, b: Array) -> None:
        """Add a block A x = b."""
        self.blocks.append((name, clarabel.ZeroConeT(len(b)), A, b))

    def add_inequality(self, name: str, A: Array, b: Array) -> None:
        """Add a block A x <= b."""
        self.blocks.append((name, clarabel.NonnegativeConeT(len(b)), A, b))

    def add_second_order_cone(self, name: str, A: Array, b: Array) -> None:
        """Add a block |(b - A x)[1:]| <= (b - A x)[0]."""
        self.blocks.append((name, clarabel.SecondOrderConeT(len(b)), A, b))

    def add_semidefinite(self, name: str, A: Array, b: Array) -> None:
        """Add a block in which b - A x is the triangle of a positive semidefinite 6 by 6 matrix."""
        self.blocks.append((name, clarabel.PSDTriangleConeT(6), A, b))

    def add_force_constraints(
        self, cones: InstantCones, s_column: int | None = None, friction: bool = True
    ) -> None:
        """Add all constraints of an instant on the first 3 n variables.

        They are equilibrium, torque, contact, friction, commands and stability.

        Args:
            cones: The instant.
            s_column: Column of s, which bounds the torques; None for the instant's largest s.
            friction: Whether to add the friction cones.
        """
        grasp = np.zeros((6, self.size))
        grasp[:, : 3 * cones.num_contacts] = cones.grasp
        self.add_equality("force.equilibrium", grasp, -cones.load)
        is_first_point, is_last_point = (np.diff(cones.limb_of, **end) != 0 for end in _DIFF_ENDS)
        for i, limb in enumerate(cones.limb_of):
            if is_first_point[i]:
                self._add_torques(cones, int(limb), s_column)
            min_force = np.array([-cones.min_normal_force])
            self.add_inequality(
                f"force.unilateral.{i}",
                -expand_contact_rows(cones.axes[i, :1], i, self.size),
                min_force,
            )
            if friction:
                rows = build_friction_rows(cones, i, self.size)
                self.add_second_order_cone(
                    f"force.friction.{i}", rows, build_friction_offsets(cones, i)
                )
            if is_last_point[i]:
                self._add_commands(cones, int(limb))
        for i in range(len(cones.penetration_per_force)):
            self.add_inequality(
                f"force.penetration.{i}",
                build_penetration_rows(cones, i, self.size),
                -cones.min_penetration[i : i + 1],
            )
        if len(cones.stiffness_loss):
            rows = pad_force_rows(cones.stiffness_loss, self.size)
            self.add_semidefinite("static.stability", rows, cones.max_stiffness_loss)

    def _add_torques(self, cones: InstantCones, i: int, s_column: int | None) -> None:
        """Add the torque limits of the i-th limb."""
        rows = pad_force_rows(np.concatenate([cones.torque[i], -cones.torque[i]]), self.size)
        if s_column is not None:
            rows[:, s_column] = -1.0
        max_ratio = 0.0 if s_column else cones.max_s
        link_terms = np.concatenate([cones.link_torque_ratio[i], -cones.link_torque_ratio[i]])
        self.add_inequality(f"torque.limit.{i}", rows, max_ratio - link_terms)

    def _add_commands(self, cones: InstantCones, i: int) -> None:
        """Add the joint bounds of the i-th limb's commands."""
        for j in range(cones.num_joints):
            self.add_inequality(
                f"kinematics.joint_bounds.{i}.{j}",
                build_command_rows(cones, i, j, self.size),
                cones.command_margin[i, j],
            )

    def minimise(self, cost: Array) -> ConicAnswer | None:
        """Return the optimum, or None if Clarabel finds none (infeasible or unbounded)."""
        A = sparse.csc_matrix(np.vstack([block[2] for block in self.blocks]))
        b = np.concatenate([block[3] for block in self.blocks])
        cones = [block[1] for block in self.blocks]
        P = sparse.csc_matrix((self.size, self.size))
        for settings in (build_clarabel_settings(), build_clarabel_settings(robust=True)):
            solution = solve_with_clarabel(P, cost, A, b, cones, settings)
            if solution is not None and str(solution.status) not in _FAILURE_STATUSES:
                break
        # The other "almost" states are as good as none: an amount must hold to three digits.
        if solution is None or str(solution.status) not in ("Solved", "AlmostSolved"):
            return None
        x, z = np.array(solution.x), np.array(solution.z)
        block_ends = np.cumsum([len(block[3]) for block in self.blocks])
        block_multipliers = np.split(z, block_ends[:-1])
        names = [block[0] for block in self.blocks]
        return ConicAnswer(x, float(cost @ x), dict(zip(names, block_multipliers, strict=True)))


def expand_contact_rows(rows: Array, point: int, size: int) -> Array:
    """Return rows (m, 3) on the force of one contact as rows (m, size) on all variables."""
    padded = np.zeros((len(rows), size))
    padded[:, 3 * point : 3 * point + 3] = rows
    return padded


def pad_force_rows(rows: Array, size: int) -> Array:
    """Return rows (m, 3 n) on all forces as rows (m, size) on all variables."""
    padded = np.zeros((len(rows), size))
    padded[:, : rows.shape[1]] = rows
    return padded


def build_command_rows(cones: InstantCones, i: int, joint: int, size: int) -> Array:
    """Return rows A of A x <= margin: the deflection of a joint's command, down and up [rad]."""
    row = cones.deflection_per_force[i, joint][None]
    return pad_force_rows(np.concatenate([row, -row]), size)


def build_penetration_rows(cones: InstantCones, i: int, size: int) -> Array:
    """Return rows A of A x <= -min_penetration: how far a toe is commanded off its surface [m]."""
    return pad_force_rows(-cones.penetration_per_force[i][None], size)


def build_friction_rows(cones: InstantCones, i: int, size: int) -> Array:
    """Return rows A with -A x = (mu n . f / S_mu, t . f, b . f) of the i-th contact."""
    axes = cones.axes[i].copy()
    axes[0] *= cones.mu[i] / cones.safety_friction
    return -expand_contact_rows(axes, i, size)


def build_friction_offsets(cones: InstantCones, i: int) -> Array:
    """Return b (3,) for the friction rows: b - A x is in the cone, whose apex is at the reserve."""
    return np.array([-cones.mu[i] / cones.safety_friction * cones.reserve, 0.0, 0.0])
