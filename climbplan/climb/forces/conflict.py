"""Find an irreducible infeasible set of an instant's constraints (IIS).

The elastic relaxation allows violations of all constraints but equilibrium and minimises their sum.
Constraints with multipliers take part in the conflict. A deletion filter (Chinneck and Dravnieks
1991) reduces them to an irreducible set: without any one member, the others are feasible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.forces.cones import (
    FEASIBLE,
    ConicProgram,
    ConstraintName,
    InstantCones,
    build_command_rows,
    build_friction_offsets,
    build_friction_rows,
    build_penetration_rows,
    expand_contact_rows,
    pad_force_rows,
)

_MULTIPLIER_TOLERANCE = 1e-6  # multiplier relative to the largest


@dataclass(frozen=True)
class Member:
    """One constraint of an instant, with the name of the check that judges it.

    It is friction, contact or commanded penetration of a limb, torque or command of a joint, or the
    stability of the whole body.
    """

    name: ConstraintName
    contact: int = -1  # place among the points of contact, of joints among the limbs in contact
    joint: int = -1  # for torques and commands


@dataclass(frozen=True)
class ElasticOptimum:
    """Optimum of the elastic relaxation."""

    total_violation: float  # sum over the members [units of the load and of the torque limits]
    multipliers: dict[Member, float]


def list_members(cones: InstantCones) -> list[Member]:
    """Return every constraint of an instant that may take part in a conflict."""
    points, limbs = range(cones.num_contacts), range(len(cones.limb))
    return [
        *(Member("force.friction", i) for i in points),
        *(Member("torque.limit", i, j) for i in limbs for j in range(cones.num_joints)),
        *(Member("force.unilateral", i) for i in points),
        *(Member("force.penetration", i) for i in range(len(cones.penetration_per_force))),
        *(Member("kinematics.joint_bounds", i, j) for i in limbs for j in range(cones.num_joints)),
        *([Member("static.stability")] if len(cones.stiffness_loss) else []),
    ]


def relax_members(cones: InstantCones, members: list[Member]) -> ElasticOptimum | None:
    """Solve the elastic relaxation of equilibrium with some constraints; None if Clarabel fails."""
    n = cones.num_contacts
    program = ConicProgram(3 * n + len(members))
    slack_columns = np.zeros((6, len(members)))
    program.add_equality("force.equilibrium", np.hstack([cones.grasp, slack_columns]), -cones.load)
    slacks = np.zeros((len(members), program.size))
    slacks[:, 3 * n :] = -np.eye(len(members))
    program.add_inequality("slack", slacks, np.zeros(len(members)))
    for index, member in enumerate(members):
        i, slack = member.contact, 3 * n + index
        if member.name == "force.friction":
            rows = build_friction_rows(cones, i, program.size)
            rows[0, slack] = -1.0
            program.add_second_order_cone(str(index), rows, build_friction_offsets(cones, i))
        elif member.name == "torque.limit":
            torque_row = cones.torque[i, member.joint : member.joint + 1]
            rows = pad_force_rows(np.vstack([torque_row, -torque_row]), program.size)
            rows[:, slack] = -1.0
            link_term = cones.link_torque_ratio[i, member.joint]
            program.add_inequality(
                str(index), rows, cones.max_s - np.array([link_term, -link_term])
            )
        elif member.name == "kinematics.joint_bounds":
            rows = build_command_rows(cones, i, member.joint, program.size)
            rows[:, slack] = -1.0
            program.add_inequality(str(index), rows, cones.command_margin[i, member.joint])
        elif member.name == "force.penetration":
            rows = build_penetration_rows(cones, i, program.size)
            rows[0, slack] = -1.0
            program.add_inequality(str(index), rows, -cones.min_penetration[i : i + 1])
        elif member.name == "static.stability":
            rows = pad_force_rows(cones.stiffness_loss, program.size)
            rows[:, slack] = -cones.max_stiffness_loss  # of which more is missing than there is
            program.add_semidefinite(str(index), rows, cones.max_stiffness_loss)
        else:
            rows = -expand_contact_rows(cones.axes[i, :1], i, program.size)
            rows[0, slack] = -1.0
            program.add_inequality(str(index), rows, np.array([-cones.min_normal_force]))
    cost = np.zeros(program.size)
    cost[3 * n :] = 1.0
    solution = program.minimise(cost)
    if solution is None:
        return None
    multipliers = {
        member: float(np.abs(solution.multipliers[str(index)]).max())
        for index, member in enumerate(members)
    }
    return ElasticOptimum(solution.value, multipliers)


def find_irreducible_conflict(cones: InstantCones) -> list[Member] | None:
    """Return an irreducible set of constraints that cannot hold together, largest multiplier first.

    Returns:
        None if the instant is feasible within FEASIBLE, or if Clarabel cannot decide.
    """
    relaxation = relax_members(cones, list_members(cones))
    if relaxation is None or relaxation.total_violation <= FEASIBLE:
        return None
    # A cone holds contact as well: where no friction whatever would do, it is not friction's fault.
    without_friction = relax_members(
        cones, [m for m in list_members(cones) if m.name != "force.friction"]
    )
    if without_friction is not None and without_friction.total_violation > FEASIBLE:
        relaxation = without_friction
    weight = relaxation.multipliers
    min_weight = _MULTIPLIER_TOLERANCE * max(weight.values())
    members = sorted((m for m in weight if weight[m] > min_weight), key=lambda m: -weight[m])
    if not _is_conflicting(cones, members):
        members = sorted(weight, key=lambda m: -weight[m])
    for member in reversed(members.copy()):
        reduced = [m for m in members if m != member]
        if _is_conflicting(cones, reduced):
            members = reduced
    return members


def _is_conflicting(cones: InstantCones, members: list[Member]) -> bool:
    """Return whether equilibrium and the members are infeasible together."""
    relaxation = relax_members(cones, members)
    return relaxation is not None and relaxation.total_violation > FEASIBLE
