"""A transition as a program with complementarity constraints that finds the sequence (ch. 5.3).

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

The same program with u binary and all pairs as rows, products of at most `COMPLEMENTS`, says
whether a point is complementary, and is what other methods solve (`problem.py`). Constraints in
addition to those of every round (`round_constraints.py`):

    contact.distance    d >= 0 where a surface bounds the room
    contact.pairs       n . f d of every surface, the product of all d, u |dp|^2
    switch.load         n . f between the least and the most load of a limb that holds
    switch.supporting   at least so many limbs hold, and one moves
    force.friction      pyramids in the cones
    solid.outside       toes out of every solid, by weights of its faces
    solid.sides         that add up to one
    integers.whole      u (1 - u)

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from climbplan.climb.transition.round_constraints import RoundConstraints, repeat_at_points
from climbplan.program.staged_program import StagedProgram
from climbplan.robots.symbolic_limbs import SymbolicLimbs
from climbplan.solvers.ipopt.staged_program import CompiledStagedProgram, compile_staged_program

FACETS = 8
POINTS = 2  # at which a toe has to be in reach: before and after the round
MAX_LOAD = 1.5  # of a limb, in units of the weight
DISTANCE = 0.2  # [m] distances and steps are measured in, so that both sides are about one
COMPLEMENTS = 2e-3  # largest product of a pair that complements
_SMOOTHING = 5e-3  # [m] within which a distance from a polygon is smooth
_STRETCH_MARGIN = 1e-3  # off full stretch, of the cosine of the knee's angle
_MAX_ITERATIONS = 200
_FORCE_PREFERENCE = 1e-4


@dataclass(frozen=True)
class ComplementarityDimensions:
    """The dimensions of a program."""

    rounds: int  # M
    kinematics: SymbolicLimbs
    surfaces: int  # S, that each limb may use
    edges: int  # E of the surfaces that do not bound the room, 0 if all do
    solids: int  # B that toes keep out of
    faces: int  # F of each

    @property
    def limbs(self) -> int:
        """Number N of limbs."""
        return self.kinematics.limbs

    @property
    def variables(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the variables of one round."""
        n = self.limbs
        return {
            "pose": (6, 1),  # at which the limbs of the round move
            "toe": (3, n),  # after the round
            "force": (3, n * self.surfaces),  # normal, tangent, bitangent [weight]
            "hold": (1, n),  # u
            "face_weight": (self.faces, n * self.solids),  # g
            "s": (1, 1),
            **repeat_at_points(self.kinematics.variable_shapes, POINTS),
        }

    @property
    def parameter_shapes(self) -> dict[str, tuple[int, int]]:
        """Names and shapes of the parameters, the same in all rounds."""
        num_pairs = self.limbs * self.surfaces
        return {
            "axes": (3, 3 * num_pairs),  # columns normal, tangent, bitangent
            "offset": (1, num_pairs),
            "bounds_room": (1, num_pairs),  # 1 if all free space is in front of it
            "edge_row": (3, num_pairs * self.edges),
            "edge_end": (1, num_pairs * self.edges),
            "face_row": (3, self.solids * self.faces),
            "face_end": (1, self.solids * self.faces),
            "mu": (1, num_pairs),
            "load": (6, 1),
            **repeat_at_points(self.kinematics.parameter_shapes, POINTS),
        }


@dataclass(frozen=True)
class ComplementarityProgram:
    """The compiled program with penalised products, and the one that checks complementarity.

    Both have the same variables; the parameters of the first end with the products' weight.
    """

    shape: ComplementarityDimensions
    penalised: CompiledStagedProgram
    formulation: StagedProgram  # pairs and binaries as rows
    rows: Any  # function (v, p) of the latter


@lru_cache(maxsize=8)
def compile_complementarity_program(shape: ComplementarityDimensions) -> ComplementarityProgram:
    """Build and compile the program of a shape."""
    settings = {
        "max_iter": _MAX_ITERATIONS,
        "tol": 1e-5,
        "constr_viol_tol": 1e-6,
        "acceptable_tol": 1e-3,
        "mu_strategy": "adaptive",
    }
    formulation = formulate_complementarity(shape)
    formulation.relax(COMPLEMENTS)
    penalised = compile_staged_program(_state(shape, penalised=True), settings, expand=True)
    rows = ca.Function("rows", [formulation.x, formulation.p], [formulation.rows])
    return ComplementarityProgram(shape, penalised, formulation, rows)


def formulate_complementarity(shape: ComplementarityDimensions) -> StagedProgram:
    """State the program of a shape with all pairs as constraints and contacts as binaries."""
    return _state(shape, penalised=False)


def _state(shape: ComplementarityDimensions, penalised: bool) -> StagedProgram:
    """State the program; penalised: products, also of binaries, cost with the weight "penalty"."""
    parameters = {**shape.parameter_shapes, **({"penalty": (1, 1)} if penalised else {})}
    rows = RoundConstraints("complementarity", shape.kinematics, shape.variables, parameters)
    pairs = _formulate_round(shape, rows)
    if penalised:
        hold = rows.symbols["hold"]
        products = ca.vertcat(pairs, hold * (1 - hold))
        rows.stage.minimise("pairs", rows.symbols["penalty"] * ca.sum1(ca.vec(products)))
    else:
        rows.stage.between("contact.pairs", pairs, upper=COMPLEMENTS)
    return rows.build_trajectory(shape.rounds, binaries=["hold"])


def _formulate_round(shape: ComplementarityDimensions, rows: RoundConstraints) -> Any:
    """State all constraints but the pairs; return the products (S + 2, N), without binaries'."""
    n, count = shape.limbs, shape.surfaces
    stage, s = rows.stage, rows.symbols
    old, new, hold, local = s["toe_before"], s["toe"], s["hold"], s["force"]
    limb_of = np.repeat(range(n), count).tolist()  # of each pair of limb and surface
    of_limb = np.kron(np.eye(n), np.ones((count, 1)))  # sums them up
    normal, along, across = (s["axes"][:, k::3] for k in range(3))

    plane = ca.sum1(normal * new[:, limb_of]) - s["offset"]
    stage.between("contact.distance", plane, unit="m")
    angle = 2 * np.pi * (np.arange(FACETS) + 0.5) / FACETS
    shear = ca.DM(np.cos(angle)) @ local[1, :] + ca.DM(np.sin(angle)) @ local[2, :]
    max_load = np.cos(np.pi / FACETS) * s["mu"] * local[0, :]
    friction = shear - ca.repmat(max_load, FACETS, 1)
    stage.between("force.friction", friction, upper=0.0, unit="weight")
    pressing = local[0, :] @ of_limb
    load = ca.vertcat(pressing - MAX_LOAD * hold, s["least_load"] * hold - pressing)
    stage.between("switch.load", load, upper=0.0, unit="weight")
    out = s["face_row"].T @ new - ca.repmat(s["face_end"].T, 1, n)  # (B F, N)
    outside = s["face_weight"] * ca.reshape(out, shape.faces, n * shape.solids)
    stage.between("solid.outside", ca.sum1(outside), 0.0, unit="m")
    stage.between("solid.sides", ca.sum1(s["face_weight"]), 1.0, 1.0)

    each = (ca.repmat(local[k, :], 3, 1) * axis for k, axis in enumerate((normal, along, across)))
    pushes = sum(each, ca.SX.zeros(3, n * count))
    force, moment = pushes @ of_limb, rows.compute_foot_moments(normal, pushes)
    if moment is not None:
        moment = moment @ of_limb
    limbs = [rows.build_limbs(point, k) for k, point in enumerate((old, new))]
    rows.add_reach(limbs, _STRETCH_MARGIN)
    torque = rows.compute_torques(limbs[0], force, moment)
    rows.add_command_limits(limbs[0], torque)
    rows.add_torque_limits(limbs[0], torque)
    rows.add_toe_steps()
    rows.add_equilibrium(limbs[0], force, moment)
    stage.between("switch.supporting", ca.sum2(hold))
    rows.add_body_step()
    rows.add_costs(_FORCE_PREFERENCE)

    before = ca.reshape(local[0, :] * _compute_distance(shape, s, old[:, limb_of]), count, n)
    after = ca.reshape(_compute_distance(shape, s, new[:, limb_of]), count, n)
    placed: Any = 1
    for k in range(count):
        placed *= after[k, :] / DISTANCE
    return ca.vertcat(before / DISTANCE, placed, hold * ca.sum1(rows.toe_step**2) / DISTANCE**2)


def _compute_distance(shape: ComplementarityDimensions, s: Mapping[str, Any], points: Any) -> Any:
    """Compute distances (1, N S) of points (3, N S) from the surface of each limb and index."""
    plane = ca.sum1(s["axes"][:, ::3] * points) - s["offset"]
    if shape.edges == 0:
        return plane
    at_edge = points[:, np.repeat(range(points.shape[1]), shape.edges).tolist()]
    edge_excess = ca.fmax(ca.sum1(s["edge_row"] * at_edge) - s["edge_end"], 0)
    squared_distance = plane**2 + ca.sum1(
        ca.reshape(edge_excess, shape.edges, points.shape[1]) ** 2
    )
    polygon = ca.sqrt(squared_distance + _SMOOTHING**2) - _SMOOTHING
    return s["bounds_room"] * plane + (1 - s["bounds_room"]) * polygon
