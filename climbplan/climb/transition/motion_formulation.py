"""The motion of a transition with a fixed contact sequence, as one nonlinear program.

In round j the body waits at pose j - 1 while some limbs move; then it moves to pose j. Variables
are the poses between start and goal, toes on intermediate footholds, contact forces on the standing
limbs, and the fraction s of the torque limits in use. The cost is the weighted sum of squared steps
and s (`round_constraints.py`). In addition to the constraints of every round there:

    transition.reach, kinematics.forward, transition.joints
                           for every toe old, new, and hovering over both
    force.friction         |f_t|^2 <= (mu / S_mu)^2 (n . f - reserve)^2
    force.contact          n . f >= minimum load of a supporting limb
    force.penetration           commanded penetration of toes >= minimum depth, to first order
    force.inside           commanded penetration >= margin, by exact kinematics
    steps.rotation         bounds on rotation steps of the body
    body.clearance         hull corners beyond a fixed face of every solid
    limbs.axis_collision        joints beyond fixed faces of solids, if limbs came too close without
    limbs.self_collision   links beyond faces of the body, and links of two limbs on both sides of
                           a plane, likewise
    foothold.plane         toes on intermediate footholds lie on their surface,
    foothold.inside        within its edges,
    foothold.stays         and stay until their limb moves

One program serves all sequences with the same number of rounds and limbs. Which limbs move, fixed
toes, normals, friction and faces are parameters (`motion_data.py`), as are the constraints' bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from climbplan.climb.postures.nlp.statement import CHORD_FACTOR
from climbplan.climb.transition.round_constraints import RoundConstraints, repeat_at_points
from climbplan.program.staged_program import StagedProgram
from climbplan.robots.symbolic_limbs import SymbolicLimbs
from climbplan.solvers.ipopt.staged_program import CompiledStagedProgram, compile_staged_program

CORNERS = 8
POINTS = 4  # per round at which a toe has to be in reach
_FORCE_PREFERENCE = 1e-5  # on squared forces in units of the weight
_STRETCH_MARGIN = 1e-4  # off full stretch, of the cosine of the knee's angle
_EDGE_MARGIN = 5e-3  # [m] off the edges of surfaces
_MAX_ITERATIONS = 80


@dataclass(frozen=True)
class MotionDimensions:
    """The dimensions of a program."""

    rounds: int  # M
    kinematics: SymbolicLimbs
    solids: int  # S
    edges: int  # E, of the surfaces of footholds between
    num_capsules: int = 0  # C capsules of a limb that keep off the body; 0: limbs are not looked at
    # (Q, 4) limb and capsule, and limb and capsule, that keep off one another
    link_pairs: tuple[tuple[int, int, int, int], ...] = ()

    @property
    def limbs(self) -> int:
        """Number N of limbs."""
        return self.kinematics.limbs

    @property
    def variables(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the variables of one round: the pose it starts from, toes after."""
        n = self.limbs
        shapes = {"pose": (6, 1), "toe": (3, n), "force": (3, n), "s": (1, 1)}
        # With the toe old, new, hovering over both
        return shapes | repeat_at_points(self.kinematics.variable_shapes, POINTS)

    @property
    def every_round(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the parameters of one round."""
        n = self.limbs
        return {
            "normal_old": (3, n),
            "normal_new": (3, n),
            "mu": (1, n),  # mu / S_mu of the surface under each limb, 0 for those that move
            **repeat_at_points(self.kinematics.parameter_shapes, POINTS),
            "edge_row": (3, n * self.edges),  # of each toe's new surface
            "edge_end": (1, n * self.edges),
            "plane": (1, n),  # offset of the new surface
            "face": (3, self.solids),
            "face_end": (1, self.solids),
            "load": (6, 1),  # payload and external wrench [weight, weight m]
            **self._separation,
        }

    @property
    def _separation(self) -> dict[str, tuple[int, int]]:
        """Shapes of faces that joints (world frame) and links (body frame) stay beyond."""
        if not self.num_capsules:
            return {}
        joints = POINTS * self.solids * (self.kinematics.joints - 1) * self.limbs
        links = POINTS * self.num_capsules * self.limbs
        return {
            "joint_face": (3, joints),
            "joint_end": (1, joints),
            "link_face": (3, links),
            "link_end": (1, links),  # with the radius of the link
            **self._limb_separation,
        }

    @property
    def _limb_separation(self) -> dict[str, tuple[int, int]]:
        """Shapes of planes that separate links of two limbs, and of the flags of moving limbs."""
        if not self.link_pairs:
            return {}
        count = POINTS * len(self.link_pairs)
        return {"limb_face": (3, count), "limb_end": (1, count), "moves": (1, self.limbs)}

    @property
    def common(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the parameters of all rounds."""
        return {
            "hull": (3, CORNERS),  # [m]
            "lift": (1, 1),  # [m]
            "least_depth": (1, 1),  # [m]
            "margin_depth": (1, 1),  # [m]
            "reserve": (1, 1),  # pressure that may go missing before a toe slips [weight]
        }


def formulate_motion(shape: MotionDimensions) -> StagedProgram:
    """State the program of a shape."""
    return _formulate_round(shape).build_trajectory(shape.rounds, shape.every_round)


@lru_cache(maxsize=8)
def compile_motion_program(shape: MotionDimensions) -> CompiledStagedProgram:
    """Build and compile the program of a shape."""
    settings = {
        "max_iter": _MAX_ITERATIONS,
        "tol": 1e-6,
        "constr_viol_tol": 1e-8,
        "mu_init": 1e-2,
        "mu_strategy": "monotone",
        "bound_relax_factor": 0.0,
    }
    return compile_staged_program(formulate_motion(shape), settings, by_stage=True)


def _formulate_round(shape: MotionDimensions) -> RoundConstraints:
    """State one round between two poses."""
    rows = RoundConstraints(
        "transition", shape.kinematics, shape.variables, {**shape.every_round, **shape.common}
    )
    stage, s = rows.stage, rows.symbols
    old, new, force = s["toe_before"], s["toe"], s["force"]
    hovering = (old + s["lift"] * s["normal_old"], new + s["lift"] * s["normal_new"])
    limbs = [rows.build_limbs(p, k) for k, p in enumerate((old, new, *hovering))]
    rows.add_reach(limbs, _STRETCH_MARGIN)

    pressure = ca.sum1(s["normal_old"] * force)
    shear = force - ca.repmat(pressure, 3, 1) * s["normal_old"]
    friction = ca.sum1(shear**2) - (s["mu"] * (pressure - s["reserve"])) ** 2
    stage.between("force.friction", friction, upper=0.0, unit="weight^2")
    stage.between("force.contact", s["least_load"] - pressure, upper=0.0, unit="weight")
    moment = rows.compute_foot_moments(s["normal_old"], force)
    torque = rows.compute_torques(limbs[0], force, moment)
    rows.add_torque_limits(limbs[0], torque)
    normal_torque = rows.compute_torques(limbs[0], s["normal_old"])
    depth = ca.sum1(normal_torque * s["softness"] * torque)
    stage.between("force.penetration", s["least_depth"] - depth, upper=0.0, unit="m")
    missing_depth = s["margin_depth"] - rows.compute_commanded_depth(limbs[0], old, torque)
    stage.between("force.inside", missing_depth, upper=0.0, unit="m")
    rows.add_command_limits(limbs[0], torque)

    toe_by_edge = new[:, np.repeat(range(shape.limbs), shape.edges).tolist()]
    edge_excess = ca.sum1(s["edge_row"] * toe_by_edge) - s["edge_end"]
    stage.between("foothold.inside", edge_excess, upper=-_EDGE_MARGIN, unit="m")
    rows.add_toe_steps()
    stage.equal("foothold.stays", rows.toe_step, "m")
    stage.equal("foothold.plane", ca.sum1(s["normal_new"] * new) - s["plane"], "m")
    rows.add_equilibrium(limbs[0], force, moment)
    rows.add_body_step()
    stage.between("steps.rotation", rows.rotation_step, unit="rad")
    corners = ca.repmat(s["pose"][:3], 1, CORNERS) + rows.rotation @ s["hull"]
    clearance = corners.T @ s["face"] - ca.repmat(s["face_end"], CORNERS, 1)
    if shape.num_capsules:
        # A rotating corner deviates from its chord; four such bulges at one end are a bound
        clearance -= (
            4 * CHORD_FACTOR * ca.sqrt(ca.sumsqr(s["hull"][:, 0])) * ca.sumsqr(rows.rotation_step)
        )
        _add_separation(shape, rows, [standing.angles for standing in limbs])
    stage.between("body.clearance", clearance, unit="m")
    rows.add_costs(_FORCE_PREFERENCE)
    return rows


def _add_separation(shape: MotionDimensions, rows: RoundConstraints, angles: list[Any]) -> None:
    """Add constraints that keep joints and links beyond fixed faces of solids, body and limbs."""
    s, n = rows.symbols, shape.limbs
    terrain_distance, body_distance, limb_distance = [], [], []
    standing_links: list[tuple[Any, Any]] = []  # links of limbs that do not move in the round
    for k, joint_angles in enumerate(angles):
        joints = shape.kinematics.points(s, joint_angles)[1:-1]
        world = [rows.transform_to_world(point) for point in joints]
        for solid in range(shape.solids):
            for j, point in enumerate(world):
                column = ((k * shape.solids + solid) * len(world) + j) * n
                face, end = (
                    s[name][:, column : column + n] for name in ("joint_face", "joint_end")
                )
                terrain_distance.append(ca.sum1(face * point) - end)
        links = shape.kinematics.pieces(s, joint_angles)
        for c, ends in enumerate(links):
            column = (k * shape.num_capsules + c) * n
            face, end = (s[name][:, column : column + n] for name in ("link_face", "link_end"))
            body_distance += [ca.sum1(face * point) - end for point in ends]
        standing_links = standing_links or links
        for q, pair in enumerate(shape.link_pairs):
            first, second = (
                _build_link_ends(s, links, standing_links, *pair[column : column + 2])
                for column in (0, 2)
            )
            column = k * len(shape.link_pairs) + q
            face, end = s["limb_face"][:, column], s["limb_end"][:, column]
            limb_distance += [ca.dot(face, p - r) - end for p in first for r in second]
    rows.stage.between("limbs.axis_collision", ca.vertcat(*terrain_distance), 0.0, unit="m")
    distances = ca.vertcat(ca.vec(ca.vertcat(*body_distance)), *limb_distance)
    rows.stage.between("limbs.self_collision", distances, 0.0, unit="m")


def _build_link_ends(
    s: dict[str, Any],
    links: list[tuple[Any, Any]],
    standing_links: list[tuple[Any, Any]],
    limb: int,
    c: int,
) -> list[Any]:
    """Build the ends (3,) of a limb's link at a point; a standing limb stays at the first one."""
    moves = s["moves"][limb]
    ends = zip(links[c], standing_links[c], strict=True)
    return [
        moves * moving_end[:, limb] + (1 - moves) * standing_end[:, limb]
        for moving_end, standing_end in ends
    ]
