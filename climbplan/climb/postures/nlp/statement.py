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
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from climbplan.climb.postures.nlp.layout import (
    LINKS,
    MOMENTS,
    Shape,
    number_layout,
    pin_layout,
    posture_layout,
    variable_layout,
)
from climbplan.climb.postures.nlp.links import link_points
from climbplan.robots.rotations import Array
from climbplan.robots.symbols import rotation
from climbplan.solvers.ipopt.program import IpoptProgram

CONVEXITY = 3.0 / 8.0  # see `turning_bulge`


def within(difference: Any, radius: Any) -> Any:
    """|difference| <= radius as a smooth row <= 0, in metres near the boundary."""
    return (ca.sumsqr(difference) - radius**2) / (2 * radius)


def turning_bulge(turn: Any, radius: Any) -> Any:
    """How far a body corner leaves the chord of its way while the body turns by `turn`.

    With x(s) = p(s) + R(Theta(s)) v, p and Theta linear in s, |x''| <= |v| (sum |dTheta|)^2
    <= 3 |v| |dTheta|^2, and a curve leaves its chord by at most max |x''| / 8.
    """
    return CONVEXITY * radius * ca.sumsqr(turn)


class _Rows:
    """Constraint rows under construction: equations = 0 and inequalities <= 0, by block."""

    def __init__(self) -> None:
        self.expressions: list[Any] = []
        self.blocks: list[tuple[str, int, bool]] = []

    def add(self, name: str, expressions: list[Any], equality: bool = False) -> None:
        if expressions:
            stacked = ca.vertcat(*expressions)
            self.expressions.append(stacked)
            self.blocks.append((name, stacked.numel(), equality))


@dataclass(frozen=True)
class _RoundFunction:
    function: Any  # (old posture, variables, pins, numbers) -> (step cost, rows)
    blocks: tuple[tuple[str, int, bool], ...]


def _round_function(shape: Shape) -> _RoundFunction:
    """One round: step costs and all constraints between two postures."""
    n = shape.limbs
    old, new = posture_layout(n).symbols(), variable_layout(n).symbols()
    pins, c = pin_layout(shape).symbols(), number_layout(shape).symbols()
    limbs = range(n)
    rows = _Rows()
    step = {name: new[name] - old[name] for name in ("com", "rpy", "toes")}

    # A, B: steps of body, toes and rotation (the rotation step bounds each axis)
    rows.add("steps.com", [within(step["com"], c["com_max"])])
    rows.add("steps.toe", [within(step["toes"][:, i], c["toe_max"]) for i in limbs])
    turns = [step["rpy"] - c["rotation_max"], -step["rpy"] - c["rotation_max"]]
    rows.add("steps.rotation", turns)
    if shape.com_min:
        least = c["com_min"] ** 2 - ca.sumsqr(step["com"])
        rows.add("steps.com_min", [least / (2 * c["com_max"])])
    if shape.toe_min:
        squares = [ca.sumsqr(step["toes"][:, i]) for i in limbs]
        least_toes = [(c["toe_min"] ** 2 - square) / (2 * c["toe_max"]) for square in squares]
        rows.add("steps.toe_min", least_toes)

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
        for i in limbs:
            origin, turned = end if moment.at_end else moving[i]
            angles = new[f"angles_{moment.name}"][:, i]
            chain = link_points(c["shoulder"][:, i], c["links"][:, i], c["mount_yaw"][i], angles)
            points = [origin + turned @ point for point in chain]
            toes, pinned = (new, "normal") if moment.new_place else (old, "old_normal")
            target = toes["toes"][:, i]
            if moment.clear:
                target = target + c["lift"] * normal(toes["toes"], pinned, i)
            ties.append(points[-1] - target)
            for obstacle, link in itertools.product(range(shape.obstacles), range(LINKS)):
                plane = planes[:, (obstacle * n + i) * LINKS + link]
                least = plane[3] + c["limb_room"]
                parted += [least - ca.dot(plane[:3], at) for at in points[link : link + 2]]
        rows.add(f"kinematics.toes_{moment.name}", ties, equality=True)
        rows.add(f"limbs.clearance_{moment.name}", parted)

    # C: workspace balls about shoulder and nominal stance
    balls = [("reach", "shoulder", "reach")]
    if shape.stance:
        balls.append(("stance", "stance", "stance_radius"))
    for label, centre, size in balls:
        for name, toes, body in (
            (label, new["toes"], dict.fromkeys(limbs, end)),
            (f"{label}_lift", old["toes"], moving),
            (f"{label}_place", new["toes"], moving),
        ):
            if name == label or shape.intermediate:
                arms = [toes[:, i] - body[i][0] - body[i][1] @ c[centre][:, i] for i in limbs]
                rows.add(f"workspace.{name}", [within(arm, c[size]) for arm in arms])

    # D: toes on their pinned region, or on the tube
    if shape.curved:
        axis, size = c["axis"], c["radius"]
        on = [within(new["toes"][:2, i] - axis, size) for i in limbs]
    else:
        on = [ca.dot(pins["normal"][:, i], new["toes"][:, i]) - pins["offset"][i] for i in limbs]
        edge = [
            pins["edge_rows"][:, i * shape.edges : (i + 1) * shape.edges].T @ new["toes"][:, i]
            - pins["edge_bounds"][:, i]
            for i in limbs
        ]
        rows.add("contact.edges", edge)
    rows.add("contact.region", on, equality=True)

    # Body clear of the terrain on its way: inside the tube, beyond one face of each obstacle.
    # Both sets are convex, so the ends of each corner's way and its bulge are enough.
    keep = c["clearance"] + turning_bulge(step["rpy"], c["hull_radius"])
    corners = []
    for com, turned in ((old["com"], rotation(old["rpy"])), end):
        corners += [com + turned @ c["hull"][:, k] for k in range(shape.hull)]
    if shape.curved:
        inside = [within(x[:2] - c["axis"], c["radius"] - keep) for x in corners]
        rows.add("body.tube", inside)
    if shape.free_rows:
        beyond = [pins["free_rows"].T @ x - pins["free_bounds"].T + keep for x in corners]
        rows.add("body.clearance", beyond)

    cost = (
        c["w_com"] * ca.sumsqr(step["com"])
        + c["w_toe"] * ca.sumsqr(step["toes"])
        + c["w_rotation"] * ca.sumsqr(step["rpy"])
    )

    def column(symbols: dict[str, Any]) -> Any:
        return ca.vertcat(*(ca.vec(symbol) for symbol in symbols.values()))

    arguments = [column(old), column(new), column(pins), column(c)]
    return _RoundFunction(
        function=ca.Function("round", arguments, [cost, ca.vertcat(*rows.expressions)]),
        blocks=tuple(rows.blocks),
    )


def _goal_function(shape: Shape) -> Any:
    """Cost and tolerance of the last posture."""
    last, c = posture_layout(shape.limbs).symbols(), number_layout(shape).symbols()
    away = {name: last[name] - c[f"goal_{name}"] for name in ("com", "rpy", "toes")}
    cost = (
        c["w_goal"] * ca.sumsqr(away["toes"])
        + c["w_goal_com"] * ca.sumsqr(away["com"])
        + c["w_goal_rotation"] * ca.sumsqr(away["rpy"])
    )
    parts = [away["com"], *ca.horzsplit(away["toes"])]
    turned = [sign * away["rpy"] - c["rotation_tolerance"] for sign in (1, -1)]
    rows = ca.vertcat(*(within(part, c["tolerance"]) for part in parts), *turned)
    arguments = [ca.vertcat(*map(ca.vec, symbols.values())) for symbols in (last, c)]
    return ca.Function("goal", arguments, [cost, rows])


@dataclass(frozen=True)
class PostureNlp:
    """The built program. Vector of variables: round after round."""

    shape: Shape
    solver: IpoptProgram
    lower: Array  # constraint bounds
    upper: Array
    blocks: dict[str, int]  # rows by name


@lru_cache(maxsize=8)
def posture_nlp(shape: Shape, iterations: int) -> PostureNlp:
    """The program of a shape with IPOPT attached; equal shapes share one."""
    m, n = shape.rounds, shape.limbs
    size, base = variable_layout(n).size, posture_layout(n).size
    pin_size, number_size = pin_layout(shape).size, number_layout(shape).size
    x = ca.MX.sym("x", size * m)
    p = ca.MX.sym("p", base + pin_size * m + number_size)
    start, pins, numbers = ca.vertsplit(p, [0, base, base + pin_size * m, p.numel()])
    new = ca.reshape(x, size, m)
    old = ca.horzcat(start, new[:base, :-1])
    each = _round_function(shape)
    cost, rows = each.function.map(m)(
        old, new, ca.reshape(pins, pin_size, m), ca.repmat(numbers, 1, m)
    )
    goal_cost, goal_rows = _goal_function(shape)(new[:base, -1], numbers)
    g = ca.vertcat(ca.vec(rows), goal_rows)

    equality = np.concatenate([np.full(count, eq) for _, count, eq in each.blocks])
    lower = np.where(
        np.append(np.tile(equality, m), np.zeros(goal_rows.numel(), bool)), 0.0, -np.inf
    )
    blocks = {name: count * m for name, count, _ in each.blocks} | {
        "goal.reached": goal_rows.numel()
    }
    settings = {
        "max_iter": iterations,
        # Lower step bounds need 5 times fewer iterations with these two, the rest a few less.
        "mu_strategy": "adaptive",
        "obj_scaling_factor": 100.0,  # costs are a few 1e-3 m^2
        "tol": 1e-8,
        "constr_viol_tol": 1e-9,
        "acceptable_tol": 1e-6,
        "acceptable_constr_viol_tol": 1e-8,
        "bound_relax_factor": 0.0,
    }
    problem = {"x": x, "p": p, "f": ca.sum2(cost) + goal_cost, "g": g}
    solver = IpoptProgram("posture", problem, settings)
    return PostureNlp(shape, solver, lower, np.zeros(len(lower)), blocks)
