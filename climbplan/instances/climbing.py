"""Instances of climbs: postures on random patches, the same with forces, and forces of instants."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.coupled.statement import coupled_program, loadable
from climbplan.climb.forces.literal import LiteralProblem, literal_problems
from climbplan.climb.forces.statement import state_forces
from climbplan.climb.postures.statement import PostureMargins, posture_program
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.model import ClimbSpec
from climbplan.instances.patch_layout import random_layout
from climbplan.instances.straight_climb import straight_climb
from climbplan.mechanics.friction import contact_frame, pyramid_rows, regular_corners
from climbplan.program.instance import Instance
from climbplan.program.linear_rows import LinearRows
from climbplan.program.statement import Program
from climbplan.schema.robots.source import load_robot

_RISE = 0.0875  # [m] a round
_FACETS = 8


def postures(rng: np.random.Generator, rounds: int) -> Instance:
    """Toes, body and rotation of each round; a limb stands on one of three patches (5.1.3)."""
    return posture_program(_layout(rng, "micp", rounds), PostureMargins()).at()


def coupled(rng: np.random.Generator, rounds: int) -> Instance:
    """The same with contact forces: moments are products of toes and forces (5.2.1)."""
    scene = loadable(_layout(rng, "coupled", rounds))
    return coupled_program(scene, PostureMargins()).at()


def forces(rng: np.random.Generator, instants: int) -> Instance:
    """Compliant contact forces within pyramids, least torques: linear, no integers (5.1.4)."""
    climb = straight_climb(int(rng.integers(1 << 30)))
    problems = literal_problems(state_forces(climb.scene, climb.instants).as_published())
    scaled = LinearRows()
    for k in np.linspace(0, len(problems) - 1, instants).astype(int):
        _instant(scaled, problems[k])
    return linear_instance(scaled, "forces")


def _layout(rng: np.random.Generator, method: str, rounds: int) -> ClimbScene:
    data = random_layout(rng, method).model_dump(exclude_none=True)
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


def _instant(rows: LinearRows, p: LiteralProblem) -> None:
    """min s - w pressure; deflections in mm and mrad, forces as shares of the load."""
    n, unit = len(p.normal), float(np.linalg.norm(p.load[:3]))
    s = rows.columns((1,), 0.0, p.largest_s)
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
        _dense(rows, "force", stiff, [*force[i], *wall[i], *body], 0.0, 0.0)
        if not p.contact[i]:
            _dense(rows, "air", np.eye(3), wall[i], 0.0, 0.0)
        torque = p.jacobian[i].T * unit / p.max_torque[i][:, None]
        for sign in (1.0, -1.0):
            within = np.hstack([sign * torque, -np.ones((3, 1))])
            _dense(rows, "torque", within, [*force[i], s[0]], -np.inf, 0.0)
        _dense(rows, "pressure", p.normal[i][None], force[i], 0.0, np.inf)
        _dense(rows, "friction", cone[i], force[i], -np.inf, 0.0)
    # A body = load + sum B_i' K_i wall_i, eq. (4.17)
    pull = np.hstack([p.motion[i].T @ p.stiffness[i] for i in range(n)])
    balance = 1e-3 * np.hstack([p.body_stiffness, -pull]) / unit
    for k in range(6):
        share = p.load[k] / unit
        _dense(rows, "balance", balance[k : k + 1], [*body, *wall.ravel()], share, share)


def _dense(rows: LinearRows, name: str, A: Array, columns: object, low: float, high: float) -> None:
    at = np.asarray(columns)
    for row in A:
        used = np.flatnonzero(np.abs(row) > 1e-14)
        rows.row(name, [(int(at[j]), float(row[j])) for j in used], low, high)


def linear_instance(rows: LinearRows, name: str) -> Instance:
    """Named rows as an instance without a quadratic cost."""
    n = len(rows.lower)
    base = Program(name)
    base.continuous("x", (n,), np.array(rows.lower), np.array(rows.upper))
    bare = base.at()
    A = sparse.csr_matrix(rows.matrix())
    return Instance(
        name=name,
        P=sparse.csc_matrix((n, n)),
        q=np.array(rows.cost),
        constant=rows.constant,
        lower=bare.lower,
        upper=bare.upper,
        A=A,
        row_lower=rows.row_lower,
        row_upper=rows.row_upper,
        balls=(),
        choices=(),
        integer=np.array(rows.integer, bool),
        products=bare.products,
        Q=sparse.csr_matrix((A.shape[0], 0)),
        implications=bare.implications,
    )
