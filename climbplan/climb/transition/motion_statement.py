"""The motion of a transition with its contact sequence fixed, as one nonlinear program.

In round j the body waits at pose j - 1 while some limbs move; then it goes on to pose j. Variables
are the poses between start and goal, toes on footholds between, contact forces on the limbs that
hold the body and the share s of the torque limits they take. Joint angles are closed-form
functions of poses and toes. Rows by block:

    transition.reach       |cos(knee)| within 1: every toe, old, new and hovering, is in reach
    transition.joints      joint angles within bounds there
    force.equilibrium      sum f = m g, sum r x f = 0 (eqs. (4.15), (4.16))
    force.friction         |f_t|^2 <= (mu / S_mu)^2 (n . f)^2
    force.contact          n . f >= least load of a limb that supports
    force.torque           |J^T f| <= s max_torque, s <= 1 / S_tau
    force.inward           toes commanded into their surface by the least depth
    force.command          angles less what forces bend them within joint bounds
    steps.com, steps.toe   body and toe steps within their bounds
    steps.rotation         turns likewise
    body.clearance         hull corners beyond a face of every solid, the face pinned
    foothold.plane         toes on footholds between lie on their surface,
    foothold.inside        within its edges,
    foothold.stays         and stay until their limb moves

One program serves all sequences of so many rounds and limbs: which limbs move, where toes are
fixed, normals, friction and faces are numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

from climbplan.climb.transition.limb_expressions import LimbExpression, limb_expression, torques
from climbplan.program.layout import Layout
from climbplan.robots.symbols import rotation
from climbplan.solvers.ipopt.program import IpoptProgram

CORNERS = 8
COST_SCALE = 100.0  # cost of about one, so that tolerances mean something
FORCE_PREFERENCE = 1e-5  # on squared forces in units of the weight: makes them unique
ITERATIONS = 80


@dataclass(frozen=True)
class Shape:
    """What a program is built for."""

    rounds: int  # M
    limbs: int  # N
    solids: int  # S
    edges: int  # E, of the surfaces of footholds between


def per_round_variables(shape: Shape) -> dict[str, tuple[int, int]]:
    """Names and shapes of the variables of one round: the pose it starts from, toes after it."""
    n = shape.limbs
    return {"pose": (6, 1), "toe": (3, n), "force": (3, n), "s": (1, 1)}


def per_round_numbers(shape: Shape) -> dict[str, tuple[int, int]]:
    """Names and shapes of the numbers of one round."""
    n = shape.limbs
    return {
        "normal_old": (3, n),
        "normal_new": (3, n),
        "mu": (1, n),  # mu / S_mu of the surface under each limb, 0 for those that move
        "branch": (4, n),  # knee branch with the toe old, new, hovering over both
        "edge_row": (3, n * shape.edges),  # of each toe's new surface
        "edge_end": (1, n * shape.edges),
        "plane": (1, n),  # offset of the new surface
        "face": (3, shape.solids),
        "face_end": (1, shape.solids),
        "load": (6, 1),  # payload and external wrench [weight, weight m]
    }


def common_numbers(shape: Shape) -> dict[str, tuple[int, int]]:
    """Names and shapes of the numbers of the robot and the costs."""
    n = shape.limbs
    return {
        "first_toe": (3, n),
        "last_pose": (6, 1),
        "shoulder": (3, n),
        "links": (3, n),
        "mount_yaw": (1, n),
        "middle": (1, n),
        "torque_limit": (3, n),  # over the weight [m]
        "softness": (3, n),  # times the weight [rad / m]
        "hull": (3, CORNERS),
        "lift": (1, 1),
        "least_load": (1, 1),
        "least_depth": (1, 1),  # [m], 0 if not asked
        "weights": (4, 1),  # com, rotation, toe, effort
    }


@dataclass(frozen=True)
class MotionProgram:
    """The compiled program of a shape, and where its rows are."""

    shape: Shape
    variables: Layout  # of one round; M of them follow each other
    numbers: Layout  # likewise, after the common ones
    common: Layout
    blocks: tuple[tuple[str, int], ...]  # of one round: name and number of rows
    solver: IpoptProgram
    rows: Any  # function (v, p) -> rows, for the exact check


@lru_cache(maxsize=8)
def motion_program(shape: Shape) -> MotionProgram:
    """Build and compile the program of a shape."""
    variables = Layout.of(per_round_variables(shape))
    numbers = Layout.of(per_round_numbers(shape))
    common = Layout.of(common_numbers(shape))
    one = _round(shape, variables, numbers, common)

    m = shape.rounds
    v = ca.MX.sym("v", variables.size * m)
    p = ca.MX.sym("p", common.size + numbers.size * m)
    shared = p[: common.size]
    parts = common.split(shared)
    cost: Any = 0
    rows = []
    old = ca.vec(parts["first_toe"])
    for j in range(m):
        own = v[j * variables.size : (j + 1) * variables.size]
        here = p[common.size + j * numbers.size : common.size + (j + 1) * numbers.size]
        after = v[(j + 1) * variables.size :][:6] if j + 1 < m else parts["last_pose"]
        price, values = one.function(old, own, after, here, shared)
        cost += price
        rows.append(values)
        old = own[variables.place("toe")]
    g = ca.vertcat(*rows)
    problem = {"x": v, "p": p, "f": COST_SCALE * cost, "g": g}
    settings = {
        "max_iter": ITERATIONS,
        "tol": 1e-6,
        "constr_viol_tol": 1e-8,
        "mu_init": 1e-2,
        "mu_strategy": "monotone",
        "bound_relax_factor": 0.0,
    }
    return MotionProgram(
        shape,
        variables,
        numbers,
        common,
        one.blocks,
        IpoptProgram("transition", problem, settings, expand=True),
        ca.Function("rows", [v, p], [g, cost]),
    )


@dataclass(frozen=True)
class _Round:
    function: Any  # (old toes, variables, next pose, numbers, common) -> (cost, rows)
    blocks: tuple[tuple[str, int], ...]


def _round(shape: Shape, variables: Layout, numbers: Layout, common: Layout) -> _Round:
    """One round between two poses."""
    n = shape.limbs
    old = ca.SX.sym("old", 3 * n)
    own, after = ca.SX.sym("own", variables.size), ca.SX.sym("after", 6)
    here, shared = ca.SX.sym("here", numbers.size), ca.SX.sym("shared", common.size)
    x, c, r = variables.split(own), numbers.split(here), common.split(shared)
    old_toe = ca.reshape(old, 3, n)
    com, rpy = x["pose"][:3], x["pose"][3:]
    turn = rotation(rpy)
    rows: dict[str, list[Any]] = {}

    def add(name: str, *expressions: Any) -> None:
        rows.setdefault(name, []).extend(expressions)

    total, moment = c["load"][:3] - ca.vertcat(0, 0, 1), c["load"][3:]
    for i in range(n):
        lift = r["lift"]
        points = (
            old_toe[:, i],
            x["toe"][:, i],
            old_toe[:, i] + lift * c["normal_old"][:, i],
            x["toe"][:, i] + lift * c["normal_new"][:, i],
        )
        limbs: list[LimbExpression] = []
        for k, point in enumerate(points):
            limb = limb_expression(
                r["shoulder"][:, i],
                r["links"][:, i],
                r["mount_yaw"][i],
                r["middle"][i],
                turn.T @ (point - com),
                c["branch"][k, i],
            )
            limbs.append(limb)
            add("transition.reach", limb.stretch)
            add("transition.joints", limb.angles)
        force = x["force"][:, i]
        total += force
        moment += ca.cross(old_toe[:, i] - com, force)
        normal = c["normal_old"][:, i]
        pressure = ca.dot(normal, force)
        shear = force - pressure * normal
        add("force.friction", ca.sumsqr(shear) - (c["mu"][i] * pressure) ** 2)
        add("force.contact", r["least_load"] - pressure)
        tau = torques(limbs[0], r["links"][:, i], turn.T @ force)
        use = tau / r["torque_limit"][:, i]
        add("force.torque", use - x["s"], -use - x["s"])
        inward = torques(limbs[0], r["links"][:, i], turn.T @ normal)
        depth = ca.sum1(inward * r["softness"][:, i] * tau)
        add("force.inward", r["least_depth"] - depth)
        add("force.command", limbs[0].angles - r["softness"][:, i] * tau)
        for e in range(shape.edges):
            at = i * shape.edges + e
            distance = ca.dot(c["edge_row"][:, at], x["toe"][:, i]) - c["edge_end"][at]
            add("foothold.inside", distance)
        add("steps.toe", ca.sumsqr(x["toe"][:, i] - old_toe[:, i]))
        add("foothold.stays", x["toe"][:, i] - old_toe[:, i])
        add("foothold.plane", ca.dot(c["normal_new"][:, i], x["toe"][:, i]) - c["plane"][i])
    add("force.equilibrium", total, moment)
    add("steps.com", ca.sumsqr(after[:3] - com))
    add("steps.rotation", after[3:] - rpy)
    for s in range(shape.solids):
        for corner in range(CORNERS):
            at_corner = com + turn @ r["hull"][:, corner]
            add("body.clearance", ca.dot(c["face"][:, s], at_corner) - c["face_end"][s])
    w = r["weights"]
    cost = (
        w[0] * ca.sumsqr(after[:3] - com)
        + w[1] * ca.sumsqr(after[3:] - rpy)
        + w[2] * ca.sumsqr(x["toe"] - old_toe)
        + w[3] * x["s"]
        + w[3] * FORCE_PREFERENCE * ca.sumsqr(x["force"])
    )
    stacked = {name: ca.vertcat(*values) for name, values in rows.items()}
    blocks = tuple((name, values.numel()) for name, values in stacked.items())
    function = ca.Function(
        "round", [old, own, after, here, shared], [cost, ca.vertcat(*stacked.values())]
    )
    return _Round(function, blocks)
