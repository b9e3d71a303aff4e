"""The posture problem of chapter 5.1.3 with exact rotations, as one nonlinear program.

Variables of round j: body origin p_COM[j], Theta[j] = (roll, pitch, yaw), toes p_i[j], and the
joint angles of every limb at the five moments that its inverse kinematics must survive: lifting
off (toe on its old place, toe clear of it), setting down (toe clear of its new place, toe on it)
and the end of the round. Exact forward kinematics tie them to the toes, so joint bounds are plain
variable bounds. Contact regions and free regions are pinned: which ones is data, not a variable.

The program is built once for a shape (numbers of rounds, limbs, rows) and holds every other
number as a parameter, so all starts of a scene, and all scenes of a study, share it.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from climbplan.climb.postures.nlp.layout import (
    MOMENTS,
    Shape,
    number_layout,
    pin_layout,
    posture_layout,
    variable_layout,
)
from climbplan.program.layout import Layout
from climbplan.program.stage import Stage
from climbplan.program.trajectory import Trajectory
from climbplan.robots.symbols import rotation
from climbplan.solvers.ipopt.trajectory import CompiledTrajectory, compiled

CONVEXITY = 3.0 / 8.0  # see `turning_bulge`
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


def within(differences: Any, radius: Any) -> Any:
    """|column| <= radius as smooth rows <= 0, in metres near the boundary; columns (3, k)."""
    return (ca.sum1(differences**2) - radius**2) / (2 * radius)


def turning_bulge(turn: Any, radius: Any) -> Any:
    """How far a body corner leaves the chord of its way while the body turns by `turn`.

    With x(s) = p(s) + R(Theta(s)) v, p and Theta linear in s, |x''| <= |v| (sum |dTheta|)^2
    <= 3 |v| |dTheta|^2, and a curve leaves its chord by at most max |x''| / 8.
    """
    return CONVEXITY * radius * ca.sumsqr(turn)


class _Laid(Stage):
    """A stage whose inputs are columns with layouts: `parts` has the matrices in each."""

    def __init__(self, name: str, **layouts: Layout) -> None:
        columns = {key: ca.SX.sym(key, layout.size) for key, layout in layouts.items()}
        super().__init__(name, columns)
        self.parts = [layout.split(columns[key]) for key, layout in layouts.items()]

    def below(self, name: str, *terms: Any, unit: str = "m") -> None:
        """Each entry of the terms <= 0."""
        self.between(name, ca.vertcat(*map(ca.vec, terms)), upper=0.0, unit=unit)


def _round(shape: Shape) -> Stage:
    """One round: (old posture, variables, pins, numbers) -> step costs and all constraints."""
    n = shape.limbs
    stage = _Laid(
        "round",
        old=posture_layout(n),
        new=variable_layout(n, shape.stated.joints),
        pins=pin_layout(shape),
        numbers=number_layout(shape),
    )
    old, new, pins, c = stage.parts
    limbs = range(n)
    step = {name: new[name] - old[name] for name in ("com", "rpy", "toes")}

    # A, B: steps of body, toes and rotation (the rotation step bounds each axis)
    stage.below("steps.com", within(step["com"], c["com_max"]))
    stage.below("steps.toe", within(step["toes"], c["toe_max"]))
    turns = [sign * step["rpy"] - c["rotation_max"] for sign in (1, -1)]
    stage.below("steps.rotation", *turns, unit="rad")
    if shape.com_min:
        least = c["com_min"] ** 2 - ca.sumsqr(step["com"])
        stage.below("steps.com", least / (2 * c["com_max"]))
    if shape.toe_min:
        least = c["toe_min"] ** 2 - ca.sum1(step["toes"] ** 2)
        stage.below("steps.toe", least / (2 * c["toe_max"]))

    # Pose of the body while each limb moves: k / N of its way for the k-th limb
    end = (new["com"], rotation(new["rpy"]))
    moving = {}
    for k, limb in enumerate(shape.gait):
        here = old["rpy"] + (k / n) * step["rpy"]
        moving[limb] = (old["com"] + (k / n) * step["com"], rotation(here))

    def normal(toes: Any, pinned: str, i: int) -> Any:
        if shape.curved:
            return ca.vertcat((c["axis"] - toes[:2, i]) / c["radius"], 0)
        return pins[pinned][:, i]

    # Exact forward kinematics at every moment, and each link beyond its planes
    for moment in MOMENTS:
        ties, parted = [], []
        planes = pins[f"planes_{moment.name}"]
        chains = shape.stated.points(c, new[f"angles_{moment.name}"])
        for i in limbs:
            origin, turned = end if moment.at_end else moving[i]
            points = [origin + turned @ point[:, i] for point in chains]
            toes, pinned = (new, "normal") if moment.new_place else (old, "old_normal")
            target = toes["toes"][:, i]
            if moment.clear:
                target = target + c["lift"] * normal(toes["toes"], pinned, i)
            ties.append(points[-1] - target)
            for obstacle, link in itertools.product(range(shape.obstacles), range(shape.links)):
                plane = planes[:, (obstacle * n + i) * shape.links + link]
                least = plane[3] + c["limb_room"]
                parted += [least - ca.dot(plane[:3], at) for at in points[link : link + 2]]
        stage.equal("kinematics.toes", ca.vertcat(*ties), "m")
        stage.below("limbs.clearance", *parted)

    # C: workspace balls about shoulder and nominal stance, also at lift and placing
    balls = [("reach", "first_joint", "reach")]
    if shape.stance:
        balls.append(("stance", "stance", "stance_radius"))
    events = [(new["toes"], dict.fromkeys(limbs, end))]
    if shape.intermediate:
        events += [(old["toes"], moving), (new["toes"], moving)]
    for label, centre, size in balls:
        for feet, body in events:
            arms = [feet[:, i] - body[i][0] - body[i][1] @ c[centre][:, i] for i in limbs]
            stage.below(f"workspace.{label}", within(ca.horzcat(*arms), c[size]))

    # D: toes on their pinned region, or on the tube
    toes = new["toes"]
    if shape.curved:
        on = within(toes[:2, :] - c["axis"], c["radius"])
    else:
        on = ca.sum1(pins["normal"] * toes) - pins["offset"]
        edges = [
            pins["edge_rows"][:, i * shape.edges : (i + 1) * shape.edges].T @ toes[:, i]
            - pins["edge_bounds"][:, i]
            for i in limbs
        ]
        stage.below("contact.region", *edges)
    stage.equal("contact.region", on, "m")

    # Body clear of the terrain on its way: inside the tube, beyond one face of each obstacle.
    # Both sets are convex, so the ends of each corner's way and its bulge are enough.
    keep = c["clearance"] + turning_bulge(step["rpy"], c["hull_radius"])
    corners = []
    for com, turned in ((old["com"], rotation(old["rpy"])), end):
        corners += [com + turned @ c["hull"][:, k] for k in range(shape.hull)]
    if shape.curved:
        inside = [within(x[:2] - c["axis"], c["radius"] - keep) for x in corners]
        stage.below("body.clearance", *inside)
    if shape.free_rows:
        beyond = [pins["free_rows"].T @ x - pins["free_bounds"].T + keep for x in corners]
        stage.below("body.clearance", *beyond)

    stage.minimise("com_step", c["w_com"] * ca.sumsqr(step["com"]))
    stage.minimise("toe_step", c["w_toe"] * ca.sumsqr(step["toes"]))
    stage.minimise("rotation_step", c["w_rotation"] * ca.sumsqr(step["rpy"]))
    return stage


def _goal(shape: Shape) -> Stage:
    """Cost and tolerance of the last posture: (posture, numbers)."""
    stage = _Laid("goal", last=posture_layout(shape.limbs), numbers=number_layout(shape))
    last, c = stage.parts
    away = {name: last[name] - c[f"goal_{name}"] for name in ("com", "rpy", "toes")}
    stage.below("goal.reached", within(ca.horzcat(away["com"], away["toes"]), c["tolerance"]))
    turned = [sign * away["rpy"] - c["rotation_tolerance"] for sign in (1, -1)]
    stage.below("goal.rotation", *turned, unit="rad")
    stage.minimise("goal", c["w_goal"] * ca.sumsqr(away["toes"]))
    stage.minimise("goal_com", c["w_goal_com"] * ca.sumsqr(away["com"]))
    stage.minimise("goal_rotation", c["w_goal_rotation"] * ca.sumsqr(away["rpy"]))
    return stage


def posture_trajectory(shape: Shape) -> Trajectory:
    """M rounds of postures: com1, rpy1, toes1, ..., com2, ...; bounds and start are given later.

    Parameters: `start` posture, `pins` of every round and `numbers`, as `layout` has them.
    """
    m, base = shape.rounds, posture_layout(shape.limbs).size
    stated = Trajectory("posture")
    start = stated.parameter("start", base)
    pins = stated.parameter("pins", pin_layout(shape).size, m)
    numbers = stated.parameter("numbers", number_layout(shape).size)
    arrays = variable_layout(shape.limbs, shape.stated.joints).shapes
    columns = [
        [stated.variable(f"{name}{j + 1}", np.zeros(rows * cols)) for name, (rows, cols) in arrays]
        for j in range(m)
    ]
    new = ca.horzcat(*(ca.vertcat(*column) for column in columns))
    stated.add(_round(shape), ca.horzcat(start, new[:base, :-1]), new, pins, numbers)
    stated.add(_goal(shape), new[:base, -1], numbers)
    return stated


@lru_cache(maxsize=8)
def posture_nlp(shape: Shape, iterations: int) -> CompiledTrajectory:
    """The program of a shape with IPOPT attached; equal shapes share one."""
    return compiled(posture_trajectory(shape), {"max_iter": iterations, **SETTINGS})
