"""The nonlinear program of a walk over all knots, compiled for IPOPT.

    minimise    tracking + motion + force differences                                 (8.30)
    subject to  rigid-body dynamics from knot to knot                        (8.14) - (8.17), (8.19)
                friction pyramids, no force on swinging legs                  (8.18), (8.23)
                toes in their workspace boxes, seen from the body             (8.20), (8.21)
                no slip of standing legs                                              (8.22)
                standing toes on their regions, swinging toes lifted          (8.23) - (8.25)
                contact complementarity c (1 - c) <= eps

Variables are state1 to stateN (position, velocity, roll pitch yaw, angular velocity), force0 to
force(N - 1), toe1 to toeN (x, y) and contact0 to contactN, leg by leg, in this order. Starts,
references and regions are parameters.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.program.staged_program import StagedProgram
from climbplan.robots.symbols import build_rotation
from climbplan.solvers.ipopt.staged_program import CompiledStagedProgram, compile_staged_program
from climbplan.walking.dynamics.dynamics import (
    BodyNumbers,
    knot_step,
    single_stage_knot_step,
    sum_contact_wrench,
)
from climbplan.walking.offline.fixed_contact_qp import FACETS, FixedContactProgram, WalkIterate
from climbplan.walking.task.task import ANGLE_RANGE, STATE, Gait, WalkTask

EPSILON = 1e-3  # of c (1 - c) <= eps
MAX_ITERATIONS = 200  # infeasible gaits would use up the default of 3000
_MAX_STRIDE = 0.6  # [m] of a toe in one interval: the constant M of eq. (8.22)


@dataclass(frozen=True)
class NlpShape:
    """All that a compiled program depends on; everything else is a parameter."""

    body: BodyNumbers
    center: tuple[float, ...]
    half: tuple[float, ...]
    force_limit: float
    friction: float  # zero: a parameter by leg and knot
    knots: int
    step: float
    mean: bool
    weights: tuple[float, ...]
    lift: float
    least_contacts: int
    regions: int
    sides: int  # of polygons, beside rectangles
    sloped: bool
    goal: tuple[float, ...]  # x, y from and to; none if not stated
    whole_stance: bool

    @classmethod
    def of(cls, task: WalkTask) -> NlpShape:
        """Return the shape of a task."""
        body, weights = task.body, task.weights
        return cls(
            BodyNumbers.of(body),
            tuple(body.toe_center.ravel().tolist()),
            tuple(body.toe_half.tolist()),
            body.force_limit,
            0.0 if task.ground.region_friction.size else task.ground.friction,
            task.knots,
            task.dt,
            task.integrator == "mean",
            (
                *weights.velocity.tolist(),
                *weights.angles.tolist(),
                weights.height,
                weights.motion,
                weights.force_difference,
            ),
            task.swing_clearance,
            task.min_contacts,
            task.ground.count,
            task.ground.corners.shape[1],
            bool(task.ground.slope.any()),
            (*task.goal.lower.tolist(), *task.goal.upper.tolist()) if task.goal.is_set else (),
            task.workspace_over_stance,
        )


@lru_cache(maxsize=4)
def compile_nlp(shape: NlpShape) -> CompiledStagedProgram:
    """Compile the program of a shape."""
    walk = WalkNlp(shape)
    walk.formulation.relax(EPSILON)
    settings = {
        "max_iter": MAX_ITERATIONS,
        "tol": 1e-4,
        "constr_viol_tol": 1e-5,
        # The guess is close to contacts of 0 and 1: do not push it away from them.
        "mu_strategy": "monotone",
        "mu_init": 0.01,
        "bound_push": 1e-4,
        "bound_frac": 1e-4,
    }
    return compile_staged_program(walk.formulation, settings, hessian=walk.build_hessian())


class WalkNlp:
    """The formulation, in the order of chapter 8.2; block names are those of the exact check."""

    def __init__(self, shape: NlpShape) -> None:
        N = shape.knots
        self.shape = shape
        self.formulation = walk = StagedProgram("walk", ca.SX)
        self.num_legs = L = len(shape.center) // 3
        tilt = np.array([np.inf] * 6 + [ANGLE_RANGE] * 2 + [np.inf] * 4)
        limit = np.full(3 * L, shape.force_limit)
        push = np.where(np.arange(3 * L) % 3 == 2, 0.0, -limit)  # legs push
        nothing, far = np.zeros(2 * L), np.inf
        knots = range(1, N + 1)
        state = [walk.variable(f"state{n}", np.zeros(STATE), -tilt, tilt) for n in knots]
        self.force = [walk.variable(f"force{n}", np.zeros(3 * L), push, limit) for n in range(N)]
        self.spot = [walk.variable(f"toe{n}", nothing, -far, far) for n in knots]
        every = range(N + 1)
        self.contact = [walk.binary(f"contact{n}", np.zeros(L)) for n in every]
        start, toes0 = walk.parameter("x0", STATE), walk.parameter("toes0", 3 * L)
        self.velocity, self.angles = walk.parameter("v_ref", 3, N), walk.parameter("a_ref", 3, N)
        self.height = walk.parameter("h_ref", N)
        self.level, self.clear = walk.parameter("level", L, N), walk.parameter("clear", L, N)
        self.low, self.high = (
            walk.parameter("low", 2 * L, N),
            walk.parameter("high", 2 * L, N),
        )
        # Rise of the regions of knots 1 to N, their planes' frames at knots 0 to N - 1, their sides
        self.rise = walk.parameter("rise", 2 * L, N) if shape.sloped else None
        self.frame = walk.parameter("frame", 9 * L, N) if shape.sloped else None
        self.friction = None if shape.friction else walk.parameter("friction", L, N)
        self.side = walk.parameter("side", 3 * shape.sides * L, N) if shape.sides else None
        self.x = [start, *state]
        self.toes = [toes0, *(self._place_toes(n) for n in knots)]
        s, t, f = ca.SX.sym("s", STATE), ca.SX.sym("t", 3 * L), ca.SX.sym("f", 3 * L)
        numbers = (shape.body, shape.step, float(shape.mean))
        self.step = ca.Function(
            "step", [s, t, f], [knot_step(*numbers, s, *sum_contact_wrench(t, f))]
        )
        self.plain_step = ca.Function(
            "plain", [s, t, f], [single_stage_knot_step(*numbers, s, *sum_contact_wrench(t, f))]
        )
        for n in range(N):
            self._add_dynamics(n)
        for n in range(N):
            self._add_force_constraints(n)
        for n in knots:
            self._add_foot_constraints(n)
            self._add_tracking_cost(n)
        self._add_goal()
        for n in range(N):
            each = ca.reshape(self.force[n], 3, L)
            apart = 2 * shape.weights[8] * (L * ca.sumsqr(each) - ca.sumsqr(ca.sum2(each)))
            walk.minimise("force_difference", apart)

    def build_hessian(self) -> ca.Function:
        """Return the Hessian of the Lagrangian, with the dynamics of the single-stage step.

        Its second derivatives are far cheaper than those of the exact step.
        """
        stated, N = self.formulation, self.shape.knots
        rows, variables = stated.rows, stated.x
        price, weight = ca.SX.sym("price", rows.numel()), ca.SX.sym("weight")
        steps = (self.plain_step(self.x[n], self.toes[n], self.force[n]) for n in range(N))
        curved = ca.vertcat(*steps, rows[STATE * N :])
        curvature, _ = ca.hessian(weight * stated.cost + ca.dot(price, curved), variables)
        return ca.Function("nlp_hess_l", [variables, stated.p, weight, price], [ca.triu(curvature)])

    def _place_toes(self, n: int) -> Any:
        """Return all toes of a knot: on the ground, or lifted, eq. (8.23)."""
        c, spot, places = self.contact[n], self.spot[n - 1], []
        for i in range(self.num_legs):
            level = self.level[i, n - 1]
            if self.rise is not None:
                level += ca.dot(self.rise[2 * i : 2 * i + 2, n - 1], spot[2 * i : 2 * i + 2])
            z = c[i] * level + (1 - c[i]) * self.clear[i, n - 1]
            places += [spot[2 * i], spot[2 * i + 1], z]
        return ca.vertcat(*places)

    def _add_dynamics(self, n: int) -> None:
        """Add the dynamics of an interval, eqs. (8.14) to (8.19)."""
        after = self.step(self.x[n], self.toes[n], self.force[n])
        self.formulation.equal("dynamics", after - self.x[n + 1])

    def _add_force_constraints(self, n: int) -> None:
        """Add friction (8.18), forces of swinging legs (8.23), and the least number of contacts."""
        walk, shape = self.formulation, self.shape
        for i in range(self.num_legs):
            fx, fy, fz = (self.force[n][3 * i + k] for k in range(3))
            c = self.contact[n][i]
            # Friction, eq. (8.18), as a pyramid inside the cone: smooth where forces vanish
            friction = shape.friction if self.friction is None else self.friction[i, n]
            slope = friction * np.cos(np.pi / FACETS)
            along, across, pressed = fx, fy, fz
            if self.frame is not None:
                axes = ca.reshape(self.frame[9 * i : 9 * i + 9, n], 3, 3).T
                along, across, pressed = ca.vertsplit(axes @ self.force[n][3 * i : 3 * i + 3])
            for k in range(FACETS):
                angle = 2 * np.pi * (k + 0.5) / FACETS
                tangent = np.cos(angle) * along + np.sin(angle) * across
                walk.between("force.friction", tangent - slope * pressed, upper=0.0, unit="N")
            # No force on lifted legs, eq. (8.23)
            walk.between("force.without_contact", fz - shape.force_limit * c, upper=0.0, unit="N")
            is_within_pyramid = 0 < shape.friction <= 1 and not shape.sloped
            if not is_within_pyramid:
                for component in (fx, fy):
                    max_force = shape.force_limit * c
                    walk.between(
                        "force.without_contact", component - max_force, upper=0.0, unit="N"
                    )
                    walk.between("force.without_contact", component + max_force, 0.0, unit="N")
        if shape.least_contacts:
            standing = ca.sum1(self.contact[n])
            walk.between(
                "gait.contacts", standing, float(shape.least_contacts), float(self.num_legs)
            )

    def _add_foot_constraints(self, n: int) -> None:
        """Add workspace (8.20), (8.21), no slip (8.22), and regions (8.24), (8.25) at a knot."""
        walk, shape = self.formulation, self.shape
        center, half = np.reshape(shape.center, (self.num_legs, 3)), np.array(shape.half)
        R = build_rotation(self.x[n][6:9])
        for i in range(self.num_legs):
            toe = self.toes[n][3 * i : 3 * i + 3]
            # Workspace, eqs. (8.20), (8.21)
            in_body = R.T @ (toe - self.x[n][:3])
            walk.between("workspace.toe", in_body, center[i] - half, center[i] + half, "m")
            if shape.whole_stance:
                # The foothold of the interval before, seen from the body at its end
                stood = R.T @ (self.toes[n - 1][3 * i : 3 * i + 3] - self.x[n][:3]) - center[i]
                for beyond in (stood - half, -stood - half):
                    violation = self.contact[n - 1][i] * beyond
                    walk.between("workspace.over_stance", violation, upper=0.0, unit="m")
            # No slip, eq. (8.22)
            free = _MAX_STRIDE * (2 - self.contact[n][i] - self.contact[n - 1][i])
            for k in range(2):
                displacement = toe[k] - self.toes[n - 1][3 * i + k]
                walk.between("contact.no_slip", displacement - free, upper=0.0, unit="m")
                walk.between("contact.no_slip", displacement + free, 0.0, unit="m")
            # Regions, eqs. (8.24), (8.25), those of the guess
            for k in range(2 if shape.regions > 1 else 0):
                slack = _MAX_STRIDE * (1 - self.contact[n][i])
                position = self.spot[n - 1][2 * i + k]
                walk.between(
                    "contact.region", position - self.low[2 * i + k, n - 1] + slack, 0.0, unit="m"
                )
                walk.between(
                    "contact.region", position - self.high[2 * i + k, n - 1] - slack, upper=0.0
                )

            for k in range(shape.sides):
                assert self.side is not None
                first = 3 * (shape.sides * i + k)
                a, b, offset = (self.side[first + j, n - 1] for j in range(3))
                violation_of_side = (
                    a * self.spot[n - 1][2 * i] + b * self.spot[n - 1][2 * i + 1] - offset
                )
                free = _MAX_STRIDE * (1 - self.contact[n][i])
                walk.between("contact.region", violation_of_side - free, upper=0.0, unit="m")

    def _add_goal(self) -> None:
        """Add the goal region of the body at the last knot."""
        for k in range(2 if self.shape.goal else 0):
            low, high = self.shape.goal[k], self.shape.goal[2 + k]
            self.formulation.between("goal.position", self.x[-1][k], low, high, "m")

    def _add_tracking_cost(self, n: int) -> None:
        """Add the tracking terms of the objective at a knot, eq. (8.30)."""
        walk, x, w = self.formulation, self.x, self.shape.weights
        for k in range(3):
            faster = x[n][3 + k] - self.velocity[k, n - 1]
            walk.minimise("tracking", w[k] * faster**2)
            walk.minimise("tracking", w[3 + k] * (x[n][6 + k] - self.angles[k, n - 1]) ** 2)
        walk.minimise("tracking", w[6] * (x[n][2] - self.height[n - 1]) ** 2)
        walk.minimise("motion", w[7] * ca.sumsqr(x[n][:3] - x[n - 1][:3]))


def build_parameters(task: WalkTask, gait: Gait, iterate: WalkIterate) -> dict[str, Array]:
    """Return the values of all parameters, in order of statement.

    Args:
        task: The task.
        gait: The gait, whose regions toes stand on.
        iterate: A motion of the gait, whose swinging toes decide which terrain they clear.
    """
    reference, ground, region = task.reference, task.ground, gait.region[1:]
    spread, (lower, upper, sides) = (task.knots, 2 * task.body.leg_count), ground.footholds
    slope = ground.slope[region]
    level = ground.height[region] - (slope * ground.inner[region]).sum(axis=-1)
    toes = _toes(task, gait, iterate)[1:]
    ground_height = level + (slope * toes[..., :2]).sum(axis=-1)
    lifted = (
        np.maximum(ground.compute_clearance_height(gait.region)[1:], ground_height)
        + task.swing_clearance
    )
    numbers = {
        "x0": task.start.state[:, None],
        "toes0": task.start.toes.reshape(-1, 1),
        "v_ref": reference.velocity.T,
        "a_ref": reference.euler.T,
        "h_ref": reference.height[:, None],
        "level": level.T,
        "clear": np.where(gait.contact[1:], lifted, toes[..., 2]).T,
        "low": lower[region].reshape(spread).T,
        "high": upper[region].reshape(spread).T,
    }
    if ground.slope.any():
        numbers["rise"] = slope.reshape(spread).T
        numbers["frame"] = ground.frame[gait.region[:-1]].reshape(task.knots, -1).T
    if ground.region_friction.size:
        numbers["friction"] = ground.find_friction(gait.region[:-1]).T
    if ground.corners.shape[1]:
        numbers["side"] = sides[region].reshape(task.knots, -1).T
    return numbers


def _toes(task: WalkTask, gait: Gait, iterate: WalkIterate) -> Array:
    """Return all toes (N + 1, L, 3) of a motion, raised above the terrain under their swings."""
    program = FixedContactProgram(task, gait)
    toes = program.compute_toes(iterate.state, iterate.spots)
    while program.raise_swing_heights(toes):
        toes = program.compute_toes(iterate.state, iterate.spots)
    return toes


def build_variables(task: WalkTask, gait: Gait, iterate: WalkIterate) -> dict[str, Array]:
    """Return the values of all variables at a motion of a gait, in order of statement."""
    toes = _toes(task, gait, iterate)
    knots = range(task.knots)
    return {
        **{f"state{n + 1}": iterate.state[n + 1] for n in knots},
        **{f"force{n}": iterate.force[n].ravel() for n in knots},
        **{f"toe{n + 1}": toes[n + 1, :, :2].ravel() for n in knots},
        **{f"contact{n}": gait.contact[n].astype(float) for n in range(task.knots + 1)},
    }


def split_variables(task: WalkTask, x: Array) -> tuple[Array, Array, Array, Array]:
    """Split a point into states 1 to N, forces, toes 1 to N (x, y) and contacts 0 to N."""
    knots, L = task.knots, task.body.leg_count
    sizes = np.cumsum([STATE * knots, 3 * L * knots, 2 * L * knots])
    state, force, toes, contact = np.split(x, sizes)
    return (
        state.reshape(knots, STATE),
        force.reshape(knots, L, 3),
        toes.reshape(knots, L, 2),
        contact.reshape(knots + 1, L),
    )
