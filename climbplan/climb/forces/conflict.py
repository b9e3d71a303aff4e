"""Which constraints of an infeasible instant cannot hold together.

The elastic relaxation lets all constraints but equilibrium be missed and minimises the sum of what
is missed. Its multipliers are those of the constraints that take part in the conflict.
From them a deletion filter keeps an irreducible set: leave out any one of its members and
the others can be met.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.forces.cones import (
    FEASIBLE,
    ConicProgram,
    InstantCones,
    Name,
    command_rows,
    friction_ends,
    friction_rows,
    inward_rows,
    on_forces,
    selector,
)

_TAKES_PART = 1e-6  # multiplier relative to the largest


@dataclass(frozen=True)
class Member:
    """One constraint of an instant, by the name of the check that judges it.

    Friction, contact or commanded depth of a limb, torque or command of a joint, stability of the
    whole.
    """

    name: Name
    contact: int = -1  # place among the points of contact, of joints among the limbs in contact
    joint: int = -1  # for torques and commands


@dataclass(frozen=True)
class Relaxation:
    """Optimum of the elastic relaxation."""

    missed: float  # sum over the members [units of the load and of the torque limits]
    multiplier: dict[Member, float]


def all_members(cones: InstantCones) -> list[Member]:
    """Every constraint of an instant that may take part in a conflict."""
    points, limbs = range(cones.contacts), range(len(cones.limb))
    return [
        *(Member("force.friction", i) for i in points),
        *(Member("torque.limit", i, j) for i in limbs for j in range(cones.joints)),
        *(Member("force.unilateral", i) for i in points),
        *(Member("force.inward", i) for i in range(len(cones.inward))),
        *(Member("kinematics.joint_bounds", i, j) for i in limbs for j in range(cones.joints)),
        *([Member("static.stability")] if len(cones.stiffness_lost) else []),
    ]


def relax(cones: InstantCones, members: list[Member]) -> Relaxation | None:
    """The elastic relaxation of equilibrium with some constraints; None if Clarabel fails."""
    n = cones.contacts
    program = ConicProgram(3 * n + len(members))
    pad = np.zeros((6, len(members)))
    program.zero("force.equilibrium", np.hstack([cones.grasp, pad]), -cones.load)
    slacks = np.zeros((len(members), program.size))
    slacks[:, 3 * n :] = -np.eye(len(members))
    program.below("slack", slacks, np.zeros(len(members)))
    for index, member in enumerate(members):
        i, slack = member.contact, 3 * n + index
        if member.name == "force.friction":
            rows = friction_rows(cones, i, program.size)
            rows[0, slack] = -1.0
            program.cone(str(index), rows, friction_ends(cones, i))
        elif member.name == "torque.limit":
            one = cones.torque[i, member.joint : member.joint + 1]
            rows = on_forces(np.vstack([one, -one]), program.size)
            rows[:, slack] = -1.0
            own = cones.links[i, member.joint]
            program.below(str(index), rows, cones.largest_s - np.array([own, -own]))
        elif member.name == "kinematics.joint_bounds":
            rows = command_rows(cones, i, member.joint, program.size)
            rows[:, slack] = -1.0
            program.below(str(index), rows, cones.room[i, member.joint])
        elif member.name == "force.inward":
            rows = inward_rows(cones, i, program.size)
            rows[0, slack] = -1.0
            program.below(str(index), rows, -cones.least_depth[i : i + 1])
        elif member.name == "static.stability":
            rows = on_forces(cones.stiffness_lost, program.size)
            rows[:, slack] = -cones.stiffness  # of which more is missing than there is
            program.semidefinite(str(index), rows, cones.stiffness)
        else:
            rows = -selector(cones.axes[i, :1], i, program.size)
            rows[0, slack] = -1.0
            program.below(str(index), rows, np.array([-cones.least_pressure]))
    cost = np.zeros(program.size)
    cost[3 * n :] = 1.0
    answer = program.minimise(cost)
    if answer is None:
        return None
    weights = {
        member: float(np.abs(answer.multipliers[str(index)]).max())
        for index, member in enumerate(members)
    }
    return Relaxation(answer.value, weights)


def conflicting_members(cones: InstantCones) -> list[Member] | None:
    """An irreducible set of constraints that cannot hold together, the weightiest first.

    None if the instant is feasible within FEASIBLE, or if Clarabel cannot tell.
    """
    relaxation = relax(cones, all_members(cones))
    if relaxation is None or relaxation.missed <= FEASIBLE:
        return None
    # A cone holds contact as well: where no friction whatever would do, it is not friction's fault.
    smooth = relax(cones, [m for m in all_members(cones) if m.name != "force.friction"])
    if smooth is not None and smooth.missed > FEASIBLE:
        relaxation = smooth
    weight = relaxation.multiplier
    least = _TAKES_PART * max(weight.values())
    members = sorted((m for m in weight if weight[m] > least), key=lambda m: -weight[m])
    if not _conflict(cones, members):
        members = sorted(weight, key=lambda m: -weight[m])
    for member in reversed(members.copy()):
        rest = [m for m in members if m != member]
        if _conflict(cones, rest):
            members = rest
    return members


def _conflict(cones: InstantCones, members: list[Member]) -> bool:
    relaxation = relax(cones, members)
    return relaxation is not None and relaxation.missed > FEASIBLE
