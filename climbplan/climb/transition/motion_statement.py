"""The motion of a transition with its contact sequence fixed, as one nonlinear program.

In round j the body waits at pose j - 1 while some limbs move; then it goes on to pose j. Variables
are the poses between start and goal, toes on footholds between, contact forces on the limbs that
hold the body and the share s of the torque limits they take. Beside the rows of every round
(`round_rows`):

    transition.reach, kinematics.toes, transition.joints
                           of every toe old, new, and hovering over both
    force.friction         |f_t|^2 <= (mu / S_mu)^2 (n . f - reserve)^2
    force.contact          n . f >= least load of a limb that supports
    force.inward           toes commanded into their surface by the least depth, to first order
    force.inside           and by what margins ask, where a free toe would really be
    steps.rotation         turns of the body within their bound
    body.clearance         hull corners beyond a face of every solid, the face pinned
    limbs.clearance        joints beyond such faces, and
    limbs.self_collision   links beyond a face of the body each, and links of two limbs on both
                           sides of a plane, where limbs came too close without
    foothold.plane         toes on footholds between lie on their surface,
    foothold.inside        within its edges,
    foothold.stays         and stay until their limb moves

One program serves all sequences of so many rounds and limbs: which limbs move, where toes are
fixed, normals, friction and faces are numbers (`motion_numbers`), and so is which rows hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from climbplan.climb.postures.nlp.statement import CONVEXITY
from climbplan.climb.transition.round_rows import RoundRows, at_points
from climbplan.program.trajectory import Trajectory
from climbplan.robots.stated_limbs import StatedLimbs
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
    stated: StatedLimbs
    solids: int  # S
    edges: int  # E, of the surfaces of footholds between
    pieces: int = 0  # C capsules of a limb that keep off the body; 0: limbs are not looked at
    # (Q, 4) limb and capsule, and limb and capsule, that keep off one another
    beside: tuple[tuple[int, int, int, int], ...] = ()

    @property
    def limbs(self) -> int:
        """N."""
        return self.stated.limbs

    @property
    def variables(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the variables of one round: the pose it starts from, toes after."""
        n = self.limbs
        own = {"pose": (6, 1), "toe": (3, n), "force": (3, n), "s": (1, 1)}
        # With the toe old, new, hovering over both
        return own | at_points(self.stated.found, POINTS)

    @property
    def every_round(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the numbers of one round."""
        n = self.limbs
        return {
            "normal_old": (3, n),
            "normal_new": (3, n),
            "mu": (1, n),  # mu / S_mu of the surface under each limb, 0 for those that move
            **at_points(self.stated.given, POINTS),
            "edge_row": (3, n * self.edges),  # of each toe's new surface
            "edge_end": (1, n * self.edges),
            "plane": (1, n),  # offset of the new surface
            "face": (3, self.solids),
            "face_end": (1, self.solids),
            "load": (6, 1),  # payload and external wrench [weight, weight m]
            **self._parting,
        }

    @property
    def _parting(self) -> dict[str, tuple[int, int]]:
        """Faces that joints are to be beyond, world, and links, body frame."""
        if not self.pieces:
            return {}
        joints = POINTS * self.solids * (self.stated.joints - 1) * self.limbs
        links = POINTS * self.pieces * self.limbs
        return {
            "joint_face": (3, joints),
            "joint_end": (1, joints),
            "link_face": (3, links),
            "link_end": (1, links),  # with the radius of the link
            **self._between,
        }

    @property
    def _between(self) -> dict[str, tuple[int, int]]:
        """Directions that part links of two limbs, and by how much [m]; which limbs move."""
        if not self.beside:
            return {}
        count = POINTS * len(self.beside)
        return {"limb_face": (3, count), "limb_end": (1, count), "moves": (1, self.limbs)}

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
        "transition", shape.stated, shape.variables, {**shape.every_round, **shape.common}
    )
    stage, s = rows.stage, rows.symbols
    old, new, force = s["toe_before"], s["toe"], s["force"]
    over = (old + s["lift"] * s["normal_old"], new + s["lift"] * s["normal_new"])
    limbs = [rows.limbs(p, k) for k, p in enumerate((old, new, *over))]
    rows.reach(limbs, _STRETCH_ROOM)

    pressure = ca.sum1(s["normal_old"] * force)
    shear = force - ca.repmat(pressure, 3, 1) * s["normal_old"]
    friction = ca.sum1(shear**2) - (s["mu"] * (pressure - s["reserve"])) ** 2
    stage.between("force.friction", friction, upper=0.0, unit="weight^2")
    stage.between("force.contact", s["least_load"] - pressure, upper=0.0, unit="weight")
    moment = rows.foot_moments(s["normal_old"], force)
    torque = rows.torques(limbs[0], force, moment)
    rows.torque(limbs[0], torque)
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
    rows.equilibrium(limbs[0], force, moment)
    rows.body_step()
    stage.between("steps.rotation", rows.turning, unit="rad")
    corners = ca.repmat(s["pose"][:3], 1, CORNERS) + rows.turn @ s["hull"]
    room = corners.T @ s["face"] - ca.repmat(s["face_end"], CORNERS, 1)
    if shape.pieces:
        # A turning corner leaves its chord by a bulge; four of them at one end are enough
        room -= 4 * CONVEXITY * ca.sqrt(ca.sumsqr(s["hull"][:, 0])) * ca.sumsqr(rows.turning)
        _keep_apart(shape, rows, [standing.angles for standing in limbs])
    stage.between("body.clearance", room, unit="m")
    rows.costs(_FORCE_PREFERENCE)
    return rows


def _keep_apart(shape: Shape, rows: RoundRows, angles: list[Any]) -> None:
    """Joints beyond a face of every solid, links beyond one of body and other limbs, all pinned."""
    s, n = rows.symbols, shape.limbs
    clear, beside, parted = [], [], []
    held: list[tuple[Any, Any]] = []  # links of limbs that do not move in the round
    for k, own in enumerate(angles):
        joints = shape.stated.points(s, own)[1:-1]
        world = [rows.world(point) for point in joints]
        for solid in range(shape.solids):
            for j, point in enumerate(world):
                at = ((k * shape.solids + solid) * len(world) + j) * n
                face, end = (s[name][:, at : at + n] for name in ("joint_face", "joint_end"))
                clear.append(ca.sum1(face * point) - end)
        links = shape.stated.pieces(s, own)
        for c, ends in enumerate(links):
            at = (k * shape.pieces + c) * n
            face, end = (s[name][:, at : at + n] for name in ("link_face", "link_end"))
            beside += [ca.sum1(face * point) - end for point in ends]
        held = held or links
        for q, pair in enumerate(shape.beside):
            one, other = (_link(s, links, held, *pair[at : at + 2]) for at in (0, 2))
            at = k * len(shape.beside) + q
            face, end = s["limb_face"][:, at], s["limb_end"][:, at]
            parted += [ca.dot(face, p - r) - end for p in one for r in other]
    rows.stage.between("limbs.clearance", ca.vertcat(*clear), 0.0, unit="m")
    apart = ca.vertcat(ca.vec(ca.vertcat(*beside)), *parted)
    rows.stage.between("limbs.self_collision", apart, 0.0, unit="m")


def _link(
    s: dict[str, Any], there: list[tuple[Any, Any]], held: list[tuple[Any, Any]], limb: int, c: int
) -> list[Any]:
    """Ends (3,) of a limb's link where the limb is at a point: `held` unless it moves."""
    moves = s["moves"][limb]
    both = zip(there[c], held[c], strict=True)
    return [moves * now[:, limb] + (1 - moves) * then[:, limb] for now, then in both]
