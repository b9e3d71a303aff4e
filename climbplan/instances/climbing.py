"""Instances of climbs: postures on random patches, with forces, and forces of instants.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.coupled.statement import formulate_coupled_program, remove_unloadable_regions
from climbplan.climb.forces.statement import build_force_statement
from climbplan.climb.forces.unreduced import UnreducedProblem, build_unreduced_problems
from climbplan.climb.postures.statement import PostureMargins, build_posture_program
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.instances.patch_layout import generate_layout
from climbplan.instances.straight_climb import build_straight_climb
from climbplan.mechanics.friction import contact_frame, pyramid_rows, regular_corners
from climbplan.program.instance import Instance
from climbplan.program.linear_rows import LinearRows
from climbplan.program.statement import Program
from climbplan.schema.robots.source import load_robot

_RISE = 0.0875  # [m] a round
_FACETS = 8


def build_posture_instance(rng: np.random.Generator, rounds: int) -> Instance:
    """Build toes, body and rotation of each round, with three patches for a limb (5.1.3)."""
    return build_posture_program(_build_scene(rng, "micp", rounds), PostureMargins()).instantiate()


def build_coupled_instance(rng: np.random.Generator, rounds: int) -> Instance:
    """Build postures with contact forces: moments are products of toes and forces (5.2.1)."""
    scene = remove_unloadable_regions(_build_scene(rng, "coupled", rounds))
    return formulate_coupled_program(scene, PostureMargins()).instantiate()


def build_force_instance(rng: np.random.Generator, instants: int) -> Instance:
    """Build compliant contact forces in pyramids with minimal torques: linear (5.1.4)."""
    climb = build_straight_climb(int(rng.integers(1 << 30)))
    problems = build_unreduced_problems(
        build_force_statement(climb.scene, climb.instants).as_published()
    )
    scaled = LinearRows()
    for k in np.linspace(0, len(problems) - 1, instants).astype(int):
        _append_instant(scaled, problems[k])
    return build_linear_instance(scaled, "forces")


def _build_scene(rng: np.random.Generator, method: str, rounds: int) -> ClimbScene:
    """Build a scene with some rounds."""
    data = generate_layout(rng, method).model_dump(exclude_none=True)
    data["task"]["rounds"] = rounds
    data["task"]["goal"] = {"com": (0.0, 0.0, round(_RISE * rounds, 4))}
    for region in data["terrain"]["regions"]:
        if region["name"].endswith("above"):  # reaches as far up as the climb does
            rise = _RISE * max(rounds - 4, 0)
            rectangle = region["rectangle"]
            x, y, z = rectangle["center"]
            rectangle["center"] = (x, y, z + rise / 2)
            rectangle["height"] += rise
    return build_scene(ClimbSpec.model_validate(data), load_robot("silvia"))


def _append_instant(rows: LinearRows, p: UnreducedProblem) -> None:
    """Append min s - w pressure; deflections in mm and mrad, forces as fractions of the load."""
    n, unit = len(p.normal), float(np.linalg.norm(p.load[:3]))
    s = rows.columns((1,), 0.0, p.max_s)
    body = rows.columns((6,), -np.inf, np.inf)
    force = rows.columns((n, 3), -np.inf, np.inf)
    pressed = p.weight * p.normal * p.contact[:, None] * unit
    rows.cost[int(s[0])] = 1.0
    for column, value in zip(force.ravel(), pressed.ravel(), strict=True):
        rows.cost[int(column)] = -float(value)
    wall = rows.columns((n, 3), -np.inf, np.inf)
    corners = np.broadcast_to(regular_corners(_FACETS), (n, _FACETS))
    cone = pyramid_rows(p.usable_mu, corners) @ contact_frame(p.normal).axes  # (n, facets, 3)
    for i in range(n):
        K, B = 1e-3 * p.stiffness[i] / unit, p.motion[i]
        stiff = np.hstack([np.eye(3), -K, K @ B])  # eq. (4.14)
        _append_rows(rows, "force", stiff, [*force[i], *wall[i], *body], 0.0, 0.0)
        if not p.contact[i]:
            _append_rows(rows, "air", np.eye(3), wall[i], 0.0, 0.0)
        torque = p.jacobian[i].T * unit / p.max_torque[i][:, None]
        for sign in (1.0, -1.0):
            within = np.hstack([sign * torque, -np.ones((3, 1))])
            _append_rows(rows, "torque", within, [*force[i], s[0]], -np.inf, 0.0)
        _append_rows(rows, "pressure", p.normal[i][None], force[i], 0.0, np.inf)
        _append_rows(rows, "friction", cone[i], force[i], -np.inf, 0.0)
    # A body = load + sum B_i' K_i wall_i, eq. (4.17)
    pull = np.hstack([p.motion[i].T @ p.stiffness[i] for i in range(n)])
    balance = 1e-3 * np.hstack([p.body_stiffness, -pull]) / unit
    for k in range(6):
        load_fraction = p.load[k] / unit
        _append_rows(
            rows,
            "balance",
            balance[k : k + 1],
            [*body, *wall.ravel()],
            load_fraction,
            load_fraction,
        )


def _append_rows(
    rows: LinearRows, name: str, A: Array, columns: object, low: float, high: float
) -> None:
    """Append the rows of a dense matrix."""
    indices = np.asarray(columns)
    for row in A:
        nonzero = np.flatnonzero(np.abs(row) > 1e-14)
        rows.row(name, [(int(indices[j]), float(row[j])) for j in nonzero], low, high)


def build_linear_instance(rows: LinearRows, name: str) -> Instance:
    """Build an instance without a quadratic cost from named rows."""
    n = len(rows.lower)
    base = Program(name)
    base.continuous("x", (n,), np.array(rows.lower), np.array(rows.upper))
    without_rows = base.instantiate()
    A = sparse.csr_matrix(rows.matrix())
    return Instance(
        name=name,
        P=sparse.csc_matrix((n, n)),
        q=np.array(rows.cost),
        constant=rows.constant,
        lower=without_rows.lower,
        upper=without_rows.upper,
        A=A,
        row_lower=rows.row_lower,
        row_upper=rows.row_upper,
        balls=(),
        choices=(),
        integer=np.array(rows.integer, bool),
        products=without_rows.products,
        Q=sparse.csr_matrix((A.shape[0], 0)),
        implications=without_rows.implications,
    )
