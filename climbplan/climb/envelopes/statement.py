"""Problem P of chapter 5.2.1, stated once: toe positions and contact forces of M postures.

Variables of posture r: weights of patch corners (eq. 5.6), body origin and rotation, toes p in
units of P (5.7, 5.9), world forces f in units of the robot's weight (5.8). The bilinear part is the
moment balance (5.11): six of the nine products p_j f_k a limb, since the cross product has none of
equal axes. Moments are taken about a point of reference that is given with the terrain instead of
about the body origin: forces add up to a known one, so the body's part c x F is linear, and toes
are measured from that point. Friction cones are pyramids inscribed in (5.15), workspaces
polytopes inscribed in the balls of (5.16): an answer satisfies the exact cone and ball.
With several patches a limb, binaries say which one it stands on (their number a limb is R).

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.envelopes.legs import INSCRIBED, Legs, build_ball_directions
from climbplan.climb.envelopes.terrains import CORNERS, LimbPatches
from climbplan.mechanics.friction import contact_frame, pyramid_rows, regular_corners
from climbplan.program import Program
from climbplan.program.statement import Expression

FACETS = 8  # of the friction pyramids
COM_RANGE = 0.5  # of the body origin about the point of reference [P]
ROTATION_LIMIT = float(np.deg2rad(10.0))  # of the body about each axis [rad]


@dataclass(frozen=True)
class PostureStatement:
    """One posture on one patch a limb: what envelopes are learned on."""

    program: Program
    legs: Legs

    def theta(self, patches: LimbPatches, load: Array | None = None) -> dict[str, Array]:
        """Return parameters of a terrain.

        load: (6,) external force [weights] and moment about the body origin [weights P] beside
        the robot's weight.
        """
        extra = np.zeros(6) if load is None else load
        return {
            "corner": patches.vertices / self.legs.length,
            "cone": compute_cone_rows(patches.normal, patches.friction),
            "force": np.array([0.0, 0.0, -1.0]) + extra[:3],
            "moment": extra[3:],
        }


def compute_cone_rows(normal: Array, friction: Array, facets: int = FACETS) -> Array:
    """Return rows a, (..., facets, 3): a . f <= 0 for world forces f in the inscribed pyramids."""
    rows = pyramid_rows(
        friction, np.broadcast_to(regular_corners(facets), (*friction.shape, facets))
    )
    return np.asarray(rows @ contact_frame(normal).axes)


def build_posture_statement(legs: Legs) -> PostureStatement:
    """Return one posture (M = 1): feasibility only, no cost."""
    n = legs.count
    p = Program("coupled posture")
    corner = p.parameter("corner", (n, CORNERS, 3))
    cone = p.parameter("cone", (n, FACETS, 3))
    force = p.parameter("force", (3,))
    moment = p.parameter("moment", (3,))
    weight = p.continuous("weight", (n, CORNERS), 0.0, 1.0)
    com = p.continuous("com", (3,), -COM_RANGE, COM_RANGE, unit="P")
    rpy = p.continuous("rpy", (3,), -ROTATION_LIMIT, ROTATION_LIMIT, unit="rad")
    toe = p.continuous("toe", (n, 3), -1.0, 1.0, unit="P")
    f = p.continuous("force", (n, 3), -1.0, 1.0, unit="weight")

    p.equal("coupled.weights", np.sum(weight, axis=1) - 1.0)
    on_patch = np.sum(weight[:, :, None] * corner, axis=1)
    p.equal("coupled.toe", on_patch - toe, unit="P")
    p.between("coupled.friction", np.sum(cone * f[:, None], axis=2), -np.inf, 0.0, unit="weight")
    _add_workspace(p, legs, toe - com[None], rpy)
    p.equal("coupled.force_balance", np.sum(f, axis=0) + force, unit="weight")
    balance = np.sum(compute_cross(toe, f), axis=0) + compute_cross(com, force) + moment
    p.equal("coupled.moment_balance", balance, unit="weight P")
    return PostureStatement(p, legs)


def _add_workspace(p: Program, legs: Legs, arm: Expression, rpy: Expression) -> None:
    """Add d . (p_i - c - R v_i) <= radius for 26 directions, rotations linearised (5.5)."""
    directions = build_ball_directions()
    for label, origin, radius in (
        ("reach", legs.shoulder, legs.reach),
        ("stance", legs.stance, legs.stance_radius),
    ):
        v = origin / legs.length
        rotated_origin = v + compute_cross(np.broadcast_to(rpy, v.shape), v)
        extent = (arm - rotated_origin) @ directions.T.astype(object)
        limit = radius * INSCRIBED / legs.length
        p.between(f"coupled.{label}", extent, -np.inf, limit, unit="P")


def compute_cross(a: Expression, b: Expression | Array) -> Expression:
    """Return a x b along the last axis, of scalars that NumPy's own cross product cannot hold."""
    shape = np.broadcast_shapes(a.shape, b.shape)
    x, y = np.broadcast_to(a, shape), np.broadcast_to(b, shape)
    out = np.empty(shape, object)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        for index in np.ndindex(shape[:-1]):
            out[(*index, k)] = x[(*index, i)] * y[(*index, j)] - x[(*index, j)] * y[(*index, i)]
    return out


def read_values(program: Program, x: Array) -> Mapping[str, Array]:
    """Return all variable blocks of a solution."""
    return {name: program.value(name, x) for name in program.variables}
