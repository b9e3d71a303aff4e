"""A transition as one nonlinear program that also finds the contact sequence (chapter 5.3).

Every toe may move in every round. Where f is a limb's contact force on a surface, d its toe's
distance from the surface, u in [0, 1] whether it holds the body, and dp its step,

    0 <= n . f   complements   d >= 0        contact, eqs. (5.17): force only without distance
    0 <= u       complements   |dp|^2 >= 0   switchability: a limb that moves carries no load
    0 <= u       complements   1 - u >= 0    a limb holds or moves
    d_1 >= 0     complements   d_2 >= 0      between rounds every toe is on a surface
    sum u >= least number of supporting limbs,   n . f <= most load times u

The products of all these pairs are summed up and weighed in the objective. The weight rises from
program to program, each starting from the last point: from some weight on minimisers have products
of zero, if such points are near (the exact penalty of such programs). Where pairs are left that do
not complement each other, no larger weight helps: another start does.

Toes keep out of a box by weights of its faces, g >= 0 with sum g = 1 and sum g_k (a_k . p - b_k)
>= 0, which exist for exactly the points that are not inside. Distances from surfaces that do not
bound the whole room (the top of a box) are those of the polygon, rounded off near zero. Friction
cones are pyramids here; the motion is then planned again with the sequence and the surfaces fixed,
on the cones as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

from climbplan.climb.transition.limb_expressions import limb_expression, torques
from climbplan.climb.transition.motion_statement import COST_SCALE
from climbplan.program.layout import Layout
from climbplan.robots.symbols import rotation
from climbplan.solvers.ipopt.program import IpoptProgram

FACETS = 8
MOST_LOAD = 1.5  # of a limb, in units of the weight
DISTANCE = 0.2  # [m] distances and steps are measured in, so that both sides are about one
_ROUND_OFF = 5e-3  # [m] within which a distance from a polygon is smooth
_ITERATIONS = 200
_FORCE_PREFERENCE = 1e-4


@dataclass(frozen=True)
class Shape:
    """What a program is built for."""

    rounds: int  # M
    limbs: int  # N
    surfaces: int  # S, that each limb may use
    edges: int  # E of the surfaces that do not bound the room, 0 if all do
    solids: int  # B that toes keep out of
    faces: int  # F of each


@dataclass(frozen=True)
class ComplementarityProgram:
    """The compiled program: M rounds of variables, common numbers, and rows by kind."""

    shape: Shape
    variables: Layout  # of one round
    numbers: Layout
    kinds: tuple[tuple[str, int], ...]  # of one round: name and number of rows
    solver: IpoptProgram
    products: Any  # function (v, p) -> (products of all pairs, rows)


def _variables(shape: Shape) -> Layout:
    n = shape.limbs
    return Layout.of(
        {
            "pose": (6, 1),  # at which the limbs of the round move
            "toe": (3, n),  # after the round
            "force": (3, n * shape.surfaces),  # normal, tangent, bitangent [weight]
            "hold": (1, n),  # u
            "side": (shape.faces, n * shape.solids),  # g
            "s": (1, 1),
        }
    )


def _numbers(shape: Shape) -> Layout:
    n = shape.limbs
    return Layout.of(
        {
            "first_toe": (3, n),
            "last_pose": (6, 1),
            "shoulder": (3, n),
            "links": (3, n),
            "mount_yaw": (1, n),
            "middle": (1, n),
            "torque_limit": (3, n),
            "softness": (3, n),
            "axes": (3, 3 * n * shape.surfaces),  # columns normal, tangent, bitangent
            "offset": (1, n * shape.surfaces),
            "bounds_room": (1, n * shape.surfaces),  # 1 if all free space is in front of it
            "edge_row": (3, n * shape.surfaces * shape.edges),
            "edge_end": (1, n * shape.surfaces * shape.edges),
            "face_row": (3, shape.solids * shape.faces),
            "face_end": (1, shape.solids * shape.faces),
            "mu": (1, n * shape.surfaces),
            "load": (6, 1),
            "least_load": (1, 1),
            "weights": (4, 1),
            "penalty": (1, 1),
        }
    )


@lru_cache(maxsize=8)
def complementarity_program(shape: Shape) -> ComplementarityProgram:
    """Build and compile the program of a shape."""
    variables, numbers = _variables(shape), _numbers(shape)
    one, kinds = _round(shape, variables, numbers)
    m = shape.rounds
    v = ca.MX.sym("v", variables.size * m)
    p = ca.MX.sym("p", numbers.size)
    c = numbers.split(p)
    old = ca.vec(c["first_toe"])
    cost: Any = 0
    rows, products = [], []
    for j in range(m):
        own = v[j * variables.size : (j + 1) * variables.size]
        after = v[(j + 1) * variables.size :][:6] if j + 1 < m else c["last_pose"]
        price, pairs, values = one(old, own, after, p)
        cost += price
        rows.append(values)
        products.append(pairs)
        old = own[variables.place("toe")]
    g, gaps = ca.vertcat(*rows), ca.vertcat(*products)
    problem = {"x": v, "p": p, "f": COST_SCALE * cost + c["penalty"] * ca.sum1(gaps), "g": g}
    settings = {
        "max_iter": _ITERATIONS,
        "tol": 1e-5,
        "constr_viol_tol": 1e-6,
        "acceptable_tol": 1e-3,
        "mu_strategy": "adaptive",
    }
    return ComplementarityProgram(
        shape,
        variables,
        numbers,
        kinds,
        IpoptProgram("complementarity", problem, settings, expand=True),
        ca.Function("products", [v, p], [gaps, g]),
    )


def _round(shape: Shape, variables: Layout, numbers: Layout) -> Any:
    """The function of one round and its kinds of rows."""
    n, surfaces = shape.limbs, shape.surfaces
    old, own = ca.SX.sym("old", 3 * n), ca.SX.sym("own", variables.size)
    after, common = ca.SX.sym("after", 6), ca.SX.sym("common", numbers.size)
    x, c = variables.split(own), numbers.split(common)
    old_toe = ca.reshape(old, 3, n)
    com, rpy = x["pose"][:3], x["pose"][3:]
    turn = rotation(rpy)
    rows: dict[str, list[Any]] = {}
    products: list[Any] = []

    def add(name: str, *expressions: Any) -> None:
        rows.setdefault(name, []).extend(expressions)

    total, moment = c["load"][:3] - ca.vertcat(0, 0, 1), c["load"][3:]
    for i in range(n):
        hold, step = x["hold"][i], x["toe"][:, i] - old_toe[:, i]
        force: Any = ca.SX.zeros(3)
        pressing: Any = 0
        placed: Any = 1
        for s in range(surfaces):
            at = i * surfaces + s
            axes = c["axes"][:, 3 * at : 3 * at + 3]
            local = x["force"][:, at]
            force += axes @ local
            pressing += local[0]
            plane = ca.dot(axes[:, 0], x["toe"][:, i]) - c["offset"][at]
            add("contact.distance", plane)
            placed *= _distance(shape, c, at, x["toe"][:, i]) / DISTANCE
            products.append(local[0] * _distance(shape, c, at, old_toe[:, i]) / DISTANCE)
            for k in range(FACETS):
                angle = 2 * ca.pi * (k + 0.5) / FACETS
                shear = local[1] * ca.cos(angle) + local[2] * ca.sin(angle)
                add("force.friction", shear - ca.cos(ca.pi / FACETS) * c["mu"][at] * local[0])
        products += [placed, hold * ca.sumsqr(step) / DISTANCE**2, hold * (1 - hold)]
        add("switch.load", pressing - MOST_LOAD * hold, c["least_load"] * hold - pressing)
        for b in range(shape.solids):
            side = x["side"][:, i * shape.solids + b]
            span = slice(b * shape.faces, (b + 1) * shape.faces)
            out = c["face_row"][:, span].T @ x["toe"][:, i] - c["face_end"][span].T
            add("solid.outside", ca.dot(side, out))
            add("solid.sides", ca.sum1(side))
        total += force
        moment += ca.cross(old_toe[:, i] - com, force)
        tau: Any = ca.SX.zeros(3)
        for which, point in enumerate((old_toe[:, i], x["toe"][:, i])):
            limb = limb_expression(
                c["shoulder"][:, i],
                c["links"][:, i],
                c["mount_yaw"][i],
                c["middle"][i],
                turn.T @ (point - com),
                -1,
            )
            add("transition.reach", limb.stretch)
            add("transition.joints", limb.angles)
            if which == 0:
                tau = torques(limb, c["links"][:, i], turn.T @ force)
                add("force.command", limb.angles - c["softness"][:, i] * tau)
        use = tau / c["torque_limit"][:, i]
        add("force.torque", use - x["s"], -use - x["s"])
        add("steps.toe", ca.sumsqr(step))
    add("force.equilibrium", total, moment)
    add("switch.supporting", ca.sum2(x["hold"]))
    add("steps.com", ca.sumsqr(after[:3] - com))
    w = c["weights"]
    cost = (
        w[0] * ca.sumsqr(after[:3] - com)
        + w[1] * ca.sumsqr(after[3:] - rpy)
        + w[2] * ca.sumsqr(x["toe"] - old_toe)
        + w[3] * (x["s"] + _FORCE_PREFERENCE * ca.sumsqr(x["force"]))
    )
    stacked = {name: ca.vertcat(*values) for name, values in rows.items()}
    kinds = tuple((name, values.numel()) for name, values in stacked.items())
    function = ca.Function(
        "round",
        [old, own, after, common],
        [cost, ca.vertcat(*products), ca.vertcat(*stacked.values())],
    )
    return function, kinds


def _distance(shape: Shape, c: dict[str, Any], at: int, point: Any) -> Any:
    """Distance of a point from a limb's surface number `at`."""
    plane = ca.dot(c["axes"][:, 3 * at], point) - c["offset"][at]
    if shape.edges == 0:
        return plane
    square = plane**2
    for e in range(at * shape.edges, (at + 1) * shape.edges):
        past = ca.dot(c["edge_row"][:, e], point) - c["edge_end"][e]
        square += ca.fmax(past, 0) ** 2
    polygon = ca.sqrt(square + _ROUND_OFF**2) - _ROUND_OFF
    bounds = c["bounds_room"][at]
    return bounds * plane + (1 - bounds) * polygon
