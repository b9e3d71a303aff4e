"""A transition as one nonlinear program that also finds the contact sequence (chapter 5.3).

Every toe may move in every round. Where f is a limb's contact force on a surface, d its toe's
distance from the surface, u in [0, 1] whether it holds the body, and dp its step,

    0 <= n . f   complements   d >= 0        contact, eqs. (5.17): force only without distance
    0 <= u       complements   |dp|^2 >= 0   switchability: a limb that moves carries no load
    0 <= u       complements   1 - u >= 0    a limb holds or moves
    d_1 >= 0     complements   d_2 >= 0      between rounds every toe is on a surface
    sum u >= least number of supporting limbs,   n . f <= most load times u

Pairs a, b >= 0 that complement each other have a Fischer-Burmeister function
a + b - sqrt(a^2 + b^2) <= eps, and eps falls step by step, each program starting from the last
point. Friction cones are pyramids here; the motion is then planned again with the sequence and the
surfaces fixed, on the cones as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

from climbplan.climb.postures.nlp_statement import rotation
from climbplan.solvers.interruption import Deadline
from climbplan.transition.limb_expressions import limb_expression, torques
from climbplan.transition.motion_statement import COST_SCALE, Layout

HOMOTOPY = (0.1, 0.03, 0.01, 1e-3)
FACETS = 8
MOST_LOAD = 4.0  # of a limb, in units of the weight
DISTANCE = 0.2  # [m] distances and steps are measured in, so that both sides are about one
_SMOOTH = 1e-10  # under the root
_ITERATIONS = 150
_FORCE_PREFERENCE = 1e-4


@dataclass(frozen=True)
class Shape:
    """What a program is built for."""

    rounds: int  # M
    limbs: int  # N
    surfaces: int  # S, that each limb may use


@dataclass(frozen=True)
class ComplementarityProgram:
    """The compiled program: M rounds of variables, common numbers, and rows by kind."""

    shape: Shape
    variables: Layout  # of one round
    numbers: Layout
    kinds: tuple[tuple[str, int], ...]  # of one round: name and number of rows
    solver: Any
    deadline: Deadline


def fischer_burmeister(a: Any, b: Any) -> Any:
    """a + b - sqrt(a^2 + b^2): zero where one of a, b >= 0 is, positive where neither is."""
    return a + b - ca.sqrt(a**2 + b**2 + _SMOOTH)


def _variables(shape: Shape) -> Layout:
    n = shape.limbs
    return Layout.of(
        {
            "pose": (6, 1),  # at which the limbs of the round move
            "toe": (3, n),  # after the round
            "force": (3, n * shape.surfaces),  # normal, tangent, bitangent [weight]
            "hold": (1, n),  # u
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
            "mu": (1, n * shape.surfaces),
            "load": (6, 1),
            "least_load": (1, 1),
            "weights": (4, 1),
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
    rows = []
    for j in range(m):
        own = v[j * variables.size : (j + 1) * variables.size]
        after = v[(j + 1) * variables.size :][:6] if j + 1 < m else c["last_pose"]
        price, values = one(old, own, after, p)
        cost += price
        rows.append(values)
        _, at, r, k = variables.names[1]
        old = own[at : at + r * k]
    g = ca.vertcat(*rows)
    deadline = Deadline(v.numel(), g.numel(), p.numel())
    options: dict[str, Any] = {
        "print_time": False,
        "expand": True,
        "error_on_fail": False,
        "iteration_callback": deadline,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "linear_solver": "mumps",
            "max_iter": _ITERATIONS,
            "tol": 1e-5,
            "constr_viol_tol": 1e-6,
            "acceptable_tol": 1e-3,
            "mu_strategy": "adaptive",
        },
    }
    problem = {"x": v, "p": p, "f": COST_SCALE * cost, "g": g}
    solver = ca.nlpsol("complementarity", "ipopt", problem, options)
    return ComplementarityProgram(shape, variables, numbers, kinds, solver, deadline)


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

    def add(name: str, *expressions: Any) -> None:
        rows.setdefault(name, []).extend(expressions)

    total, moment = c["load"][:3] - ca.vertcat(0, 0, 1), c["load"][3:]
    for i in range(n):
        hold, step = x["hold"][i], x["toe"][:, i] - old_toe[:, i]
        force: Any = ca.SX.zeros(3)
        pressing: Any = 0
        distances = []
        for s in range(surfaces):
            at = i * surfaces + s
            axes = c["axes"][:, 3 * at : 3 * at + 3]
            local = x["force"][:, at]
            force += axes @ local
            pressing += local[0]
            old_distance = ca.dot(axes[:, 0], old_toe[:, i]) - c["offset"][at]
            distance = ca.dot(axes[:, 0], x["toe"][:, i]) - c["offset"][at]
            distances.append(distance / DISTANCE)
            add("contact.distance", distance)
            add("contact.complementarity", fischer_burmeister(local[0], old_distance / DISTANCE))
            for k in range(FACETS):
                angle = 2 * ca.pi * (k + 0.5) / FACETS
                shear = local[1] * ca.cos(angle) + local[2] * ca.sin(angle)
                add("force.friction", shear - ca.cos(ca.pi / FACETS) * c["mu"][at] * local[0])
        if surfaces == 2:
            add("contact.placed", fischer_burmeister(*distances))
        else:
            product: Any = 1
            for distance in distances:
                product *= distance
            add("contact.placed", product)
        add("switch.complementarity", fischer_burmeister(hold, ca.sumsqr(step) / DISTANCE**2))
        add("switch.binary", fischer_burmeister(hold, 1 - hold))
        add("switch.load", pressing - MOST_LOAD * hold, c["least_load"] * hold - pressing)
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
    add("force.equilibrium", total, moment)
    add("switch.supporting", ca.sum2(x["hold"]))
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
        "round", [old, own, after, common], [cost, ca.vertcat(*stacked.values())]
    )
    return function, kinds
