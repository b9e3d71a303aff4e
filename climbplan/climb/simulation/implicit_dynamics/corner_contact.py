"""Solve the contact of a toe in a corner, where it slid on one surface into another.

The toe sticks as long as its force is a sum of two forces, one in each surface's friction cone.
Otherwise it continues along the surface that it reached last.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.contact import SLIDES, _compute_toe_force
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import _dot, _set_identity
from climbplan.climb.simulation.implicit_dynamics.state import (
    BodyState,
    ContactSolution,
    ContactState,
    JointSprings,
    ScratchMemory,
    TerrainGeometry,
)
from climbplan.climb.simulation.implicit_dynamics.surfaces import (
    SURFACE_TOLERANCE,
    TUBE,
    _find_first_hit,
    _project_to_surface,
)

_MAX_PROJECTIONS = 30  # on the two cones in turn
_FORCE_TOLERANCE = 1e-3  # relative, that neither cone supports


@compiled
def _solve_corner_contact(
    body: BodyState,
    zero: Array,
    limb: int,
    mu: float,
    contacts: ContactState,
    ground: TerrainGeometry,
    springs: JointSprings,
    solution: ContactSolution,
    work: ScratchMemory,
) -> bool:
    """Return whether both surfaces together support a toe at its anchor; if so, it sticks.

    The force is split by alternating projections on the two cones. Results of a toe that sticks are
    left in `solution` and `work` as by `contact._solve_contact`.
    """
    if not _compute_toe_force(body, zero, limb, springs, solution, work):
        return False
    solid, face = contacts.corner_face[limb, 0], contacts.corner_face[limb, 1]
    projected, corner_normal = work.vectors[rows.CORNER_POINT], work.vectors[rows.CORNER_NORMAL]
    surface_force, corner_force = work.vectors[rows.SURFACE_FORCE], work.vectors[rows.CORNER_FORCE]
    for a in range(3):
        projected[a] = solution.position[limb, a]
        surface_force[a] = corner_force[a] = 0.0
    _project_to_surface(projected, solid, face, ground, corner_normal)
    corner_friction = 0.0
    if not contacts.frictionless[limb]:
        corner_friction = ground.tube_friction[solid] if face == TUBE else ground.friction[solid]
    force, remainder = solution.force[limb], work.vectors[rows.REMAINDER]
    for _ in range(_MAX_PROJECTIONS):
        for a in range(3):
            remainder[a] = force[a] - corner_force[a]
        _project_to_cone(remainder, solution.normal[limb], mu, surface_force)
        for a in range(3):
            remainder[a] = force[a] - surface_force[a]
        _project_to_cone(remainder, corner_normal, corner_friction, corner_force)
        residual = 0.0
        for a in range(3):
            residual += (force[a] - surface_force[a] - corner_force[a]) ** 2
        if residual <= _FORCE_TOLERANCE**2 * _dot(force, force):
            _set_identity(work.force_projection)
            return True
    return False


@compiled
def _project_to_cone(vector: Array, normal: Array, mu: float, out: Array) -> None:
    """Project a force (3,) to a friction cone: out is the nearest force in the cone."""
    press = _dot(vector, normal)
    shear = 0.0
    for a in range(3):
        shear += (vector[a] - press * normal[a]) ** 2
    shear = np.sqrt(shear)
    if shear <= mu * press:
        for a in range(3):
            out[a] = vector[a]
        return
    size = (press + mu * shear) / (1 + mu * mu)
    if size <= 0.0:
        for a in range(3):
            out[a] = 0.0
        return
    for a in range(3):
        tangent = (vector[a] - press * normal[a]) / shear
        out[a] = size * (normal[a] + mu * tangent)


@compiled
def _find_obstacle_hit(
    limb: int, contacts: ContactState, ground: TerrainGeometry, solution: ContactSolution
) -> tuple[int, int, float]:
    """Return solid and face into which a toe has slid in a step, -1 if none, and the depth [m]."""
    if solution.mode[limb] != SLIDES or solution.face[limb] == TUBE:
        return -1, -1, 0.0
    start, end = contacts.anchor[limb], solution.position[limb]
    if not contacts.in_contact[limb]:
        return -1, -1, 0.0
    solid, face, fraction = _find_first_hit(
        start, end, ground, -SURFACE_TOLERANCE, solution.solid[limb]
    )
    overshoot = 0.0
    for a in range(3):
        overshoot += ((1 - fraction) * (end[a] - start[a])) ** 2
    return solid, face, np.sqrt(overshoot) if solid >= 0 else 0.0
