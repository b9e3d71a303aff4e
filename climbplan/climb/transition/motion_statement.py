"""The motion of a transition with its contact sequence fixed, as one nonlinear program.

In round j the body waits at pose j - 1 while some limbs move; then it goes on to pose j. Variables
are the poses between start and goal, toes on footholds between, contact forces on the limbs that
hold the body and the share s of the torque limits they take. Beside the rows of every round
(`round_rows`):

    transition.reach, .joints  of every toe old, new, and hovering over both
    force.friction         |f_t|^2 <= (mu / S_mu)^2 (n . f - reserve)^2
    force.contact          n . f >= least load of a limb that supports
    force.inward           toes commanded into their surface by the least depth, to first order
    force.inside           and by what margins ask, where a free toe would really be
    steps.rotation         turns of the body within their bound
    body.clearance         hull corners beyond a face of every solid, the face pinned
    foothold.plane         toes on footholds between lie on their surface,
    foothold.inside        within its edges,
    foothold.stays         and stay until their limb moves

One program serves all sequences of so many rounds and limbs: which limbs move, where toes are
fixed, normals, friction and faces are numbers (`motion_numbers`), and so is which rows hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from climbplan.climb.transition.round_rows import RoundRows
from climbplan.program.trajectory import Trajectory
from climbplan.solvers.ipopt.trajectory import CompiledTrajectory, compiled

CORNERS = 8
POINTS = 4  # at which a toe has to be in reach
_FORCE_PREFERENCE = 1e-5  # on squared forces in units of the weight
_STRETCH_ROOM = 1e-4  # off full stretch, of the cosine of the knee's angle
_EDGE_ROOM = 5e-3  # [m] off the edges of surfaces
_ITERATIONS = 80


@dataclass(frozen=True)
class Shape:
    """What a program is built for."""

    rounds: int  # M
    limbs: int  # N
    solids: int  # S
    edges: int  # E, of the surfaces of footholds between

    @property
    def variables(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the variables of one round: the pose it starts from, toes after."""
        return {"pose": (6, 1), "toe": (3, self.limbs), "force": (3, self.limbs), "s": (1, 1)}

    @property
    def every_round(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the numbers of one round."""
        n = self.limbs
        return {
            "normal_old": (3, n),
            "normal_new": (3, n),
            "mu": (1, n),  # mu / S_mu of the surface under each limb, 0 for those that move
            "branch": (POINTS, n),  # knee branch with the toe old, new, hovering over both
            "edge_row": (3, n * self.edges),  # of each toe's new surface
            "edge_end": (1, n * self.edges),
            "plane": (1, n),  # offset of the new surface
            "face": (3, self.solids),
            "face_end": (1, self.solids),
            "load": (6, 1),  # payload and external wrench [weight, weight m]
        }

    @property
    def common(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the numbers of all rounds."""
        return {
            "hull": (3, CORNERS),  # [m]
            "lift": (1, 1),  # [m]
            "least_depth": (1, 1),  # [m]
            "margin_depth": (1, 1),  # [m]
            "reserve": (1, 1),  # pressure that may go missing before a toe slips [weight]
        }


def motion_statement(shape: Shape) -> Trajectory:
    """The program of a shape, as it is stated."""
    return _round(shape).trajectory(shape.rounds, shape.every_round)


@lru_cache(maxsize=8)
def motion_program(shape: Shape) -> CompiledTrajectory:
    """Build and compile the program of a shape."""
    settings = {
        "max_iter": _ITERATIONS,
        "tol": 1e-6,
        "constr_viol_tol": 1e-8,
        "mu_init": 1e-2,
        "mu_strategy": "monotone",
        "bound_relax_factor": 0.0,
    }
    return compiled(motion_statement(shape), settings, expand=True)


def _round(shape: Shape) -> RoundRows:
    """One round between two poses."""
    rows = RoundRows(
        "transition", shape.limbs, shape.variables, {**shape.every_round, **shape.common}
    )
    stage, s = rows.stage, rows.symbols
    old, new, force = s["toe_before"], s["toe"], s["force"]
    over = (old + s["lift"] * s["normal_old"], new + s["lift"] * s["normal_new"])
    limbs = [rows.limbs(p, s["branch"][k, :]) for k, p in enumerate((old, new, *over))]
    rows.reach(limbs, _STRETCH_ROOM)

    pressure = ca.sum1(s["normal_old"] * force)
    shear = force - ca.repmat(pressure, 3, 1) * s["normal_old"]
    friction = ca.sum1(shear**2) - (s["mu"] * (pressure - s["reserve"])) ** 2
    stage.between("force.friction", friction, upper=0.0, unit="weight^2")
    stage.between("force.contact", s["least_load"] - pressure, upper=0.0, unit="weight")
    torque = rows.torques(limbs[0], force)
    rows.torque(torque)
    inward = rows.torques(limbs[0], s["normal_old"])
    depth = ca.sum1(inward * s["softness"] * torque)
    stage.between("force.inward", s["least_depth"] - depth, upper=0.0, unit="m")
    inside = s["margin_depth"] - rows.commanded_depth(limbs[0], old, torque)
    stage.between("force.inside", inside, upper=0.0, unit="m")
    rows.command(limbs[0], torque)

    at_edge = new[:, np.repeat(range(shape.limbs), shape.edges).tolist()]
    beyond = ca.sum1(s["edge_row"] * at_edge) - s["edge_end"]
    stage.between("foothold.inside", beyond, upper=-_EDGE_ROOM, unit="m")
    rows.toe_steps()
    stage.equal("foothold.stays", rows.step, "m")
    stage.equal("foothold.plane", ca.sum1(s["normal_new"] * new) - s["plane"], "m")
    rows.equilibrium(force)
    rows.body_step()
    stage.between("steps.rotation", rows.turning, unit="rad")
    corners = ca.repmat(s["pose"][:3], 1, CORNERS) + rows.turn @ s["hull"]
    room = corners.T @ s["face"] - ca.repmat(s["face_end"], CORNERS, 1)
    stage.between("body.clearance", room, unit="m")
    rows.costs(_FORCE_PREFERENCE)
    return rows
