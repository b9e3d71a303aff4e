"""One instant's exact constraints on the forces themselves, for questions about feasibility.

The plan itself is made on the reduced form; here forces stay variables, so that a load, a friction
coefficient or a torque limit can be a variable as well. Forces are in units of the load.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import clarabel
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.clarabel import clarabel_settings, solve_with_clarabel
from climbplan.climb.forces.restrictions import stability_cone
from climbplan.climb.forces.statement import ForceStatement
from climbplan.mechanics.equilibrium import grasp_matrix
from climbplan.mechanics.friction import contact_frame

# Of constraints, as the check of forces, postures or statics has them
Name = Literal[
    "force.friction",
    "torque.limit",
    "force.unilateral",
    "force.inward",
    "kinematics.joint_bounds",
    "static.stability",
]
_GAVE_UP = ("NumericalError", "InsufficientProgress", "MaxIterations")
_ENDS: tuple[dict[str, Any], ...] = ({"prepend": -1}, {"append": -1})  # of points by limb
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
    links: Array  # (l, J) torque / limit of the links' own weight
    largest_s: float
    least_pressure: float  # of every contact
    reserve: float  # pressure that each may miss before it slips
    inward: Array  # (l or 0, 3 n) depth of commanded toes inside their surfaces by forces [m]
    least_depth: Array  # (l or 0,) of these [m]
    bending: Array  # (l, J, 3 n) joint angles less commands by forces [rad]
    room: Array  # (l, J, 2) for commands below and above the joint angles [rad]
    stiffness_lost: Array  # (21 or 0, 3 n) triangle of the stiffness lost by forces
    stiffness: Array  # (21 or 0,) of what they may take at most

    @property
    def contacts(self) -> int:
        """n."""
        return len(self.limb_of)

    @property
    def joints(self) -> int:
        """J."""
        return self.torque.shape[1]

    def with_friction(self, factor: float) -> InstantCones:
        """The same instant with all friction coefficients scaled."""
        return replace(self, mu=self.mu * factor)


def instant_cones(statement: ForceStatement, k: int) -> InstantCones:
    """The constraints of instant k."""
    limb, point = np.flatnonzero(statement.standing[k]), np.flatnonzero(statement.contact[k])
    limb_of = np.repeat(np.arange(len(limb)), statement.points)
    scale = np.array([1.0] * 3 + [1 / statement.length] * 3)
    bending = statement.bending[k][limb][:, :, point].reshape(len(limb), -1, 3 * len(point))
    depth = statement.least_depth[k, limb]
    asked = limb if (depth > -np.inf).all() else limb[:0]
    inward = statement.inward[k][asked][:, point].reshape(len(asked), 3 * len(point))
    stability = stability_cone(statement, np.array([k]))
    lost = stability.A[0][:, point].reshape(-1, 3 * len(point))
    own = statement.torque_per_force[k, point] * statement.unit  # (n, J, 3)
    torque = np.zeros((len(limb), own.shape[1], len(point), 3))
    torque[limb_of, :, np.arange(len(point))] = own
    return InstantCones(
        limb=limb,
        limb_of=limb_of,
        grasp=grasp_matrix(statement.arms[k, point]) * scale[:, None],
        load=statement.load[k] * scale / statement.unit,
        axes=contact_frame(statement.normal[k, point]).axes,
        mu=statement.mu[k, point],
        safety_friction=statement.safety_friction,
        torque=torque.reshape(*torque.shape[:2], -1),
        links=statement.links_share[k, limb],
        largest_s=float(statement.largest_s[k]),
        least_pressure=float(statement.least_pressure[k]) / statement.unit,
        reserve=float(statement.reserve[k]) / statement.unit,
        inward=inward * statement.unit,
        least_depth=depth[: len(asked)],
        bending=bending * statement.unit,
        room=np.stack([statement.room_below[k, limb], statement.room_above[k, limb]], axis=-1),
        stiffness_lost=lost * statement.unit,
        stiffness=stability.upper[0],
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

    def zero(self, name: str, A: Array, b: Array) -> None:
        """A x = b."""
        self.blocks.append((name, clarabel.ZeroConeT(len(b)), A, b))

    def below(self, name: str, A: Array, b: Array) -> None:
        """A x <= b."""
        self.blocks.append((name, clarabel.NonnegativeConeT(len(b)), A, b))

    def cone(self, name: str, A: Array, b: Array) -> None:
        """|(b - A x)[1:]| <= (b - A x)[0]."""
        self.blocks.append((name, clarabel.SecondOrderConeT(len(b)), A, b))

    def semidefinite(self, name: str, A: Array, b: Array) -> None:
        """b - A x is the triangle of a positive semidefinite matrix, 6 by 6."""
        self.blocks.append((name, clarabel.PSDTriangleConeT(6), A, b))

    def forces(
        self, cones: InstantCones, s_column: int | None = None, friction: bool = True
    ) -> None:
        """Equilibrium, torque, contact, friction, commands, stability on the first 3 n variables.

        Torque against s in a column of its own, or against the instant's largest s.
        """
        grasp = np.zeros((6, self.size))
        grasp[:, : 3 * cones.contacts] = cones.grasp
        self.zero("force.equilibrium", grasp, -cones.load)
        firsts, lasts = (np.diff(cones.limb_of, **end) != 0 for end in _ENDS)
        for i, limb in enumerate(cones.limb_of):
            if firsts[i]:
                self._torques(cones, int(limb), s_column)
            press = np.array([-cones.least_pressure])
            self.below(f"force.unilateral.{i}", -selector(cones.axes[i, :1], i, self.size), press)
            if friction:
                rows = friction_rows(cones, i, self.size)
                self.cone(f"force.friction.{i}", rows, friction_ends(cones, i))
            if lasts[i]:
                self._commands(cones, int(limb))
        for i in range(len(cones.inward)):
            self.below(
                f"force.inward.{i}",
                inward_rows(cones, i, self.size),
                -cones.least_depth[i : i + 1],
            )
        if len(cones.stiffness_lost):
            rows = on_forces(cones.stiffness_lost, self.size)
            self.semidefinite("static.stability", rows, cones.stiffness)

    def _torques(self, cones: InstantCones, i: int, s_column: int | None) -> None:
        """Torques of the i-th limb."""
        rows = on_forces(np.concatenate([cones.torque[i], -cones.torque[i]]), self.size)
        if s_column is not None:
            rows[:, s_column] = -1.0
        most = 0.0 if s_column else cones.largest_s
        own = np.concatenate([cones.links[i], -cones.links[i]])
        self.below(f"torque.limit.{i}", rows, most - own)

    def _commands(self, cones: InstantCones, i: int) -> None:
        """Commands of the i-th limb."""
        for j in range(cones.joints):
            self.below(
                f"kinematics.joint_bounds.{i}.{j}",
                command_rows(cones, i, j, self.size),
                cones.room[i, j],
            )

    def minimise(self, cost: Array) -> ConicAnswer | None:
        """The optimum, or None if Clarabel finds none (infeasible or unbounded)."""
        A = sparse.csc_matrix(np.vstack([block[2] for block in self.blocks]))
        b = np.concatenate([block[3] for block in self.blocks])
        cones = [block[1] for block in self.blocks]
        P = sparse.csc_matrix((self.size, self.size))
        for settings in (clarabel_settings(), clarabel_settings(robust=True)):
            solution = solve_with_clarabel(P, cost, A, b, cones, settings)
            if solution is not None and str(solution.status) not in _GAVE_UP:
                break
        # The other "almost" states are as good as none: an amount must hold to three digits.
        if solution is None or str(solution.status) not in ("Solved", "AlmostSolved"):
            return None
        x, z = np.array(solution.x), np.array(solution.z)
        ends = np.cumsum([len(block[3]) for block in self.blocks])
        parts = np.split(z, ends[:-1])
        names = [block[0] for block in self.blocks]
        return ConicAnswer(x, float(cost @ x), dict(zip(names, parts, strict=True)))


def selector(rows: Array, point: int, size: int) -> Array:
    """Rows (m, 3) on the force of the point-th contact, as rows (m, size) on all variables."""
    out = np.zeros((len(rows), size))
    out[:, 3 * point : 3 * point + 3] = rows
    return out


def on_forces(rows: Array, size: int) -> Array:
    """Rows (m, 3 n) on all forces, as rows (m, size) on all variables."""
    out = np.zeros((len(rows), size))
    out[:, : rows.shape[1]] = rows
    return out


def command_rows(cones: InstantCones, i: int, joint: int, size: int) -> Array:
    """Rows A with A x <= room: how far the i-th contact's joint is commanded down and up [rad]."""
    row = cones.bending[i, joint][None]
    return on_forces(np.concatenate([row, -row]), size)


def inward_rows(cones: InstantCones, i: int, size: int) -> Array:
    """Rows A with A x <= -least depth: how far the i-th toe is commanded off its surface [m]."""
    return on_forces(-cones.inward[i][None], size)


def friction_rows(cones: InstantCones, i: int, size: int) -> Array:
    """Rows A with -A x = (mu n . f / S_mu, t . f, b . f) of the i-th contact."""
    axes = cones.axes[i].copy()
    axes[0] *= cones.mu[i] / cones.safety_friction
    return -selector(axes, i, size)


def friction_ends(cones: InstantCones, i: int) -> Array:
    """Ends b (3,) beside those rows: b - A x is in the cone that begins where the reserve ends."""
    return np.array([-cones.mu[i] / cones.safety_friction * cones.reserve, 0.0, 0.0])
