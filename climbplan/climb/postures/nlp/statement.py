"""The posture problem of chapter 5.1.3 with exact rotations, as one nonlinear program.

Variables of round j are the body origin p_COM[j], Theta[j] = (roll, pitch, yaw), the toes p_i[j],
and the joint angles of every limb at five moments. These are lifting off (toe on its old place, toe
clear of it), setting down (toe clear of its new place, toe on it) and the end of the round.

    minimise    squared steps of body, toes and rotation + squared distances to the goal
    subject to  step lengths within com_max, toe_max, rotation_max         A, B
                toes within workspace balls of shoulders and stances       C
                toes on their fixed contact regions, or on the tube        D
                forward kinematics(angles) = toe at every moment           kinematics.forward
                links beyond fixed separating planes of the obstacles      limbs.axis_collision
                body corners within fixed free regions, or the tube        body.clearance
                joint angles within bounds, goal within tolerance

Contact regions, free regions and planes are fixed: which ones is a parameter, not a variable. The
program is built once for a shape (numbers of rounds, limbs, rows) and has every other number as a
parameter. So all starts of a scene, and all scenes of a study, share it.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from climbplan.climb.postures.nlp.layout import (
    MOMENTS,
    NlpStructure,
    build_number_layout,
    build_pin_layout,
    build_posture_layout,
    build_variable_layout,
)
from climbplan.program.layout import MatrixLayout
from climbplan.program.stage import Stage
from climbplan.program.staged_program import StagedProgram
from climbplan.robots.symbols import build_rotation
from climbplan.solvers.ipopt.staged_program import CompiledStagedProgram, compile_staged_program

CHORD_FACTOR = 3.0 / 8.0  # see `bound_chord_deviation`
SETTINGS = {
    # Lower step bounds need 5 times fewer iterations with these two, the rest a few less.
    "mu_strategy": "adaptive",
    "obj_scaling_factor": 100.0,  # costs are a few 1e-3 m^2
    "tol": 1e-8,
    "constr_viol_tol": 1e-9,
    "acceptable_tol": 1e-6,
    "acceptable_constr_viol_tol": 1e-8,
    "bound_relax_factor": 0.0,
}


def ball_rows(differences: Any, radius: Any) -> Any:
    """Return rows <= 0 for |column| <= radius, smooth and in metres near the boundary; columns (3,
    k).
    """
    return (ca.sum1(differences**2) - radius**2) / (2 * radius)


def bound_chord_deviation(turn: Any, radius: Any) -> Any:
    """Bound how far a body corner leaves the chord of its path while the body rotates by `turn`.

    With x(s) = p(s) + R(Theta(s)) v, p and Theta linear in s, |x''| <= |v| (sum |dTheta|)^2 <= 3
    |v| |dTheta|^2, and a curve leaves its chord by at most max |x''| / 8.
    """
    return CHORD_FACTOR * radius * ca.sumsqr(turn)


class _LayoutStage(Stage):
    """A stage whose inputs are columns with layouts; `matrices` has the named arrays of each."""

    def __init__(self, name: str, **layouts: MatrixLayout) -> None:
        columns = {key: ca.SX.sym(key, layout.size) for key, layout in layouts.items()}
        super().__init__(name, columns)
        self.matrices = [layout.split(columns[key]) for key, layout in layouts.items()]

    def add_upper_bound(self, name: str, *terms: Any, unit: str = "m") -> None:
        """Add a block in which each entry of the terms is <= 0."""
        self.between(name, ca.vertcat(*map(ca.vec, terms)), upper=0.0, unit=unit)


def _build_round_stage(shape: NlpStructure) -> Stage:
    """Build the stage of one round: (old posture, variables, pins, numbers) -> costs and
    constraints.
    """
    n = shape.limbs
    stage = _LayoutStage(
        "round",
        old=build_posture_layout(n),
        new=build_variable_layout(n, shape.kinematics.joints),
        pins=build_pin_layout(shape),
        numbers=build_number_layout(shape),
    )
    old, new, _, c = stage.matrices
    step = {name: new[name] - old[name] for name in ("com", "rpy", "toes")}
    # Pose of the body while each limb moves: k / N of its way for the k-th limb
    end = (new["com"], build_rotation(new["rpy"]))
    at_move = {}
    for k, limb in enumerate(shape.gait):
        rpy_at_move = old["rpy"] + (k / n) * step["rpy"]
        at_move[limb] = (old["com"] + (k / n) * step["com"], build_rotation(rpy_at_move))
    poses = _BodyPoses(end, at_move)

    _add_step_limits(stage, shape, step)
    _add_limb_kinematics(stage, shape, poses)
    _add_workspaces(stage, shape, poses)
    _add_contacts(stage, shape)
    _add_body_clearance(stage, shape, poses, step)
    stage.minimise("com_step", c["w_com"] * ca.sumsqr(step["com"]))
    stage.minimise("toe_step", c["w_toe"] * ca.sumsqr(step["toes"]))
    stage.minimise("rotation_step", c["w_rotation"] * ca.sumsqr(step["rpy"]))
    return stage


_Pose = tuple[Any, Any]  # origin (3,) and rotation (3, 3) of the body


class _BodyPoses(NamedTuple):
    """Poses of the body in a round."""

    end: _Pose
    at_move: dict[int, _Pose]  # while each limb moves


def _add_step_limits(stage: _LayoutStage, shape: NlpStructure, step: dict[str, Any]) -> None:
    """Bound the steps of body, toes and rotation (A, B); that of rotation about each axis."""
    c = stage.matrices[3]
    stage.add_upper_bound("steps.com", ball_rows(step["com"], c["com_max"]))
    stage.add_upper_bound("steps.toe", ball_rows(step["toes"], c["toe_max"]))
    turns = [sign * step["rpy"] - c["rotation_max"] for sign in (1, -1)]
    stage.add_upper_bound("steps.rotation", *turns, unit="rad")
    if shape.has_com_min:
        min_violation = c["com_min"] ** 2 - ca.sumsqr(step["com"])
        stage.add_upper_bound("steps.com", min_violation / (2 * c["com_max"]))
    if shape.has_toe_min:
        min_violation = c["toe_min"] ** 2 - ca.sum1(step["toes"] ** 2)
        stage.add_upper_bound("steps.toe", min_violation / (2 * c["toe_max"]))


def _add_limb_kinematics(stage: _LayoutStage, shape: NlpStructure, poses: _BodyPoses) -> None:
    """Tie angles to toes by exact forward kinematics, and keep each link beyond its planes."""
    old, new, pins, c = stage.matrices
    n = shape.limbs

    def normal(toes: Any, pin_name: str, i: int) -> Any:
        if shape.is_curved:
            return ca.vertcat((c["axis"] - toes[:2, i]) / c["radius"], 0)
        return pins[pin_name][:, i]

    for moment in MOMENTS:
        residuals, plane_violations = [], []
        planes = pins[f"planes_{moment.name}"]
        chains = shape.kinematics.points(c, new[f"angles_{moment.name}"])
        for i in range(n):
            origin, rotation_of_body = poses.end if moment.at_end else poses.at_move[i]
            points = [origin + rotation_of_body @ point[:, i] for point in chains]
            toes, pin_name = (new, "normal") if moment.at_new_contact else (old, "old_normal")
            target = toes["toes"][:, i]
            if moment.is_lifted:
                target = target + c["lift"] * normal(toes["toes"], pin_name, i)
            residuals.append(points[-1] - target)
            for obstacle, link in itertools.product(range(shape.num_obstacles), range(shape.links)):
                plane = planes[:, (obstacle * n + i) * shape.links + link]
                min_violation = plane[3] + c["limb_room"]
                plane_violations += [
                    min_violation - ca.dot(plane[:3], link_end)
                    for link_end in points[link : link + 2]
                ]
        stage.equal("kinematics.forward", ca.vertcat(*residuals), "m")
        stage.add_upper_bound("limbs.axis_collision", *plane_violations)


def _add_workspaces(stage: _LayoutStage, shape: NlpStructure, poses: _BodyPoses) -> None:
    """Require toes in balls about shoulder and nominal stance, also at lift and placing (C)."""
    old, new, _, c = stage.matrices
    limbs = range(shape.limbs)
    balls = [("reach", "first_joint", "reach")]
    if shape.has_stance_ball:
        balls.append(("stance", "stance", "stance_radius"))
    events = [(new["toes"], dict.fromkeys(limbs, poses.end))]
    if shape.checks_during_round:
        events += [(old["toes"], poses.at_move), (new["toes"], poses.at_move)]
    for label, centre, radius_name in balls:
        for feet, body in events:
            arms = [feet[:, i] - body[i][0] - body[i][1] @ c[centre][:, i] for i in limbs]
            stage.add_upper_bound(
                f"workspace.{label}", ball_rows(ca.horzcat(*arms), c[radius_name])
            )


def _add_contacts(stage: _LayoutStage, shape: NlpStructure) -> None:
    """Require toes on their fixed region, or on the tube (D)."""
    _, new, pins, c = stage.matrices
    toes = new["toes"]
    if shape.is_curved:
        surface_residual = ball_rows(toes[:2, :] - c["axis"], c["radius"])
    else:
        surface_residual = ca.sum1(pins["normal"] * toes) - pins["offset"]
        edges = [
            pins["edge_rows"][:, i * shape.max_edges : (i + 1) * shape.max_edges].T @ toes[:, i]
            - pins["edge_bounds"][:, i]
            for i in range(shape.limbs)
        ]
        stage.add_upper_bound("contact.region", *edges)
    stage.equal("contact.region", surface_residual, "m")


def _add_body_clearance(
    stage: _LayoutStage, shape: NlpStructure, poses: _BodyPoses, step: dict[str, Any]
) -> None:
    """Keep the body's way inside the tube, and beyond one face of each obstacle.

    Both sets are convex, so the ends of each corner's way and its bulge are enough.
    """
    old, _, pins, c = stage.matrices
    clearance = c["clearance"] + bound_chord_deviation(step["rpy"], c["hull_radius"])
    corners = []
    for com, rotation_of_body in ((old["com"], build_rotation(old["rpy"])), poses.end):
        corners += [com + rotation_of_body @ c["hull"][:, k] for k in range(shape.num_hull_corners)]
    if shape.is_curved:
        tube_violations = [ball_rows(x[:2] - c["axis"], c["radius"] - clearance) for x in corners]
        stage.add_upper_bound("body.clearance", *tube_violations)
    if shape.num_free_rows:
        free_region_violations = [
            pins["free_rows"].T @ x - pins["free_bounds"].T + clearance for x in corners
        ]
        stage.add_upper_bound("body.clearance", *free_region_violations)


def _build_goal_stage(shape: NlpStructure) -> Stage:
    """Build the stage of the goal: cost and tolerance of the last posture."""
    stage = _LayoutStage(
        "goal", last=build_posture_layout(shape.limbs), numbers=build_number_layout(shape)
    )
    last, c = stage.matrices
    deviation = {name: last[name] - c[f"goal_{name}"] for name in ("com", "rpy", "toes")}
    stage.add_upper_bound(
        "goal.position", ball_rows(ca.horzcat(deviation["com"], deviation["toes"]), c["tolerance"])
    )
    rotation_excess = [sign * deviation["rpy"] - c["rotation_tolerance"] for sign in (1, -1)]
    stage.add_upper_bound("goal.rotation", *rotation_excess, unit="rad")
    stage.minimise("goal", c["w_goal"] * ca.sumsqr(deviation["toes"]))
    stage.minimise("goal_com", c["w_goal_com"] * ca.sumsqr(deviation["com"]))
    stage.minimise("goal_rotation", c["w_goal_rotation"] * ca.sumsqr(deviation["rpy"]))
    return stage


def build_posture_trajectory(shape: NlpStructure) -> StagedProgram:
    """Build M rounds of postures: com1, rpy1, toes1, ..., com2, ...; without bounds and initial
    values.

    Parameters are the `start` posture, the `pins` of every round and `numbers`, as in `layout`.
    """
    num_rounds, posture_size = shape.num_rounds, build_posture_layout(shape.limbs).size
    trajectory = StagedProgram("posture")
    start = trajectory.parameter("start", posture_size)
    pins = trajectory.parameter("pins", build_pin_layout(shape).size, num_rounds)
    numbers = trajectory.parameter("numbers", build_number_layout(shape).size)
    arrays = build_variable_layout(shape.limbs, shape.kinematics.joints).shapes
    columns = [
        [
            trajectory.variable(f"{name}{j + 1}", np.zeros(rows * cols))
            for name, (rows, cols) in arrays
        ]
        for j in range(num_rounds)
    ]
    variables = ca.horzcat(*(ca.vertcat(*column) for column in columns))
    trajectory.add(
        _build_round_stage(shape),
        ca.horzcat(start, variables[:posture_size, :-1]),
        variables,
        pins,
        numbers,
    )
    trajectory.add(_build_goal_stage(shape), variables[:posture_size, -1], numbers)
    return trajectory


@lru_cache(maxsize=8)
def compile_posture_nlp(shape: NlpStructure, iterations: int) -> CompiledStagedProgram:
    """Return the program of a shape with IPOPT attached; equal shapes share one."""
    return compile_staged_program(
        build_posture_trajectory(shape), {"max_iter": iterations, **SETTINGS}
    )
