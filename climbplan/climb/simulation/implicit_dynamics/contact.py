"""Solve the contact of one toe with a surface: it sticks, slides or separates (Coulomb friction).

A toe in contact is first placed where it stood last, its anchor. It separates if the surface would
have to pull. If its force leaves the friction cone it slides until the force is on the cone, which
is the return mapping of plasticity.

Coulomb's law has several solutions or none where pressure grows as a toe slides. Short steps
therefore project the force to the cone, in the metric of the limb's compliance. The projection is
unique and continuous. It lifts the toe by mu times its slip in the step; the toe is put back on its
surface at the end of the step. MuJoCo's convex contact model does the same (Todorov 2014).
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.friction_cone import _project_to_cone_surface
from climbplan.climb.simulation.implicit_dynamics.limb_equilibrium import _solve_limb
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import (
    _apply_matrix,
    _apply_transpose,
    _dot,
    _invert,
    _set_identity,
    _transform_matrix,
)
from climbplan.climb.simulation.implicit_dynamics.state import (
    BodyState,
    ContactSolution,
    JointSprings,
    ScratchMemory,
    StepSettings,
    TerrainGeometry,
)
from climbplan.climb.simulation.implicit_dynamics.surfaces import _project_to_surface

AIR, STICKS, SLIDES, FAILED = 0, 1, 2, 3
_MAX_SLIDE_STEPS = 4  # Newton steps along the direction of sliding
_MAX_SLIDE_STEP = 0.03  # [m] longest of these steps
_DETACHMENT_SHEAR_RATIO = 0.02  # shear by pull, below which a toe separates without sliding
_MIN_SLIDE_STIFFNESS = 0.3  # smallest stiffness against sliding, by that at constant pressure
_POSITION_TOLERANCE = 1e-7  # [m] of a projected contact
_FRICTION_TOLERANCE = 1e-3  # relative, of a sliding toe's friction


@compiled
def _compute_toe_force(
    body: BodyState,
    zero: Array,
    limb: int,
    springs: JointSprings,
    solution: ContactSolution,
    work: ScratchMemory,
) -> bool:
    """Compute the force on a toe at its place, and `work.contact_stiffness` G = R K R^T.

    Returns False if the limb does not reach that place.
    """
    offset, toe_body = work.vectors[rows.OFFSET], work.vectors[rows.TOE_BODY]
    force_body, stiffness_body = work.vectors[rows.FORCE_BODY], work.matrices[rows.STIFFNESS_BODY]
    for i in range(3):
        offset[i] = solution.position[limb, i] - body.com[i]
    _apply_transpose(body.rotation, offset, toe_body)
    if not _solve_limb(
        zero, limb, toe_body, springs, solution.angles[limb], force_body, stiffness_body, work
    ):
        return False
    _apply_matrix(body.rotation, force_body, solution.force[limb])
    _transform_matrix(
        body.rotation, stiffness_body, work.matrices[rows.BUFFER], work.contact_stiffness
    )
    return True


@compiled
def _project_contact(
    body: BodyState,
    zero: Array,
    limb: int,
    mu: float,
    springs: JointSprings,
    solution: ContactSolution,
    work: ScratchMemory,
) -> int:
    """Project the force to the friction cone, in the metric of the limb's compliance.

    Arguments and results are those of `_solve_contact`.
    """
    position, normal, force = solution.position[limb], solution.normal[limb], solution.force[limb]
    stiffness, compliance = work.contact_stiffness, work.matrices[rows.COMPLIANCE]
    offset, free_motion = work.vectors[rows.DISPLACEMENT], work.vectors[rows.FREE_MOTION]
    trial_force, cone_force = work.vectors[rows.TRIAL_FORCE], work.vectors[rows.CONE_FORCE]
    tangent, binormal = work.vectors[rows.TANGENT], work.vectors[rows.BINORMAL]
    s0, s1, s2 = position[0], position[1], position[2]
    for attempt in range(_MAX_SLIDE_STEPS + 1):
        if not _compute_toe_force(body, zero, limb, springs, solution, work):
            return FAILED
        if not _invert(stiffness, compliance) > 0.0:
            return FAILED
        # The force with the toe at its anchor, and where the toe would move without contact
        offset[0], offset[1], offset[2] = s0 - position[0], s1 - position[1], s2 - position[2]
        _apply_matrix(stiffness, offset, trial_force)
        for i in range(3):
            trial_force[i] += force[i]
        _apply_matrix(compliance, trial_force, free_motion)
        if _lifts_off(free_motion, normal, mu):
            return AIR
        press = _dot(trial_force, normal)
        shear = np.sqrt(max(_dot(trial_force, trial_force) - press * press, 0.0))
        if shear <= mu * press:
            if (
                offset[0] == 0.0 and offset[1] == 0.0 and offset[2] == 0.0
            ) or attempt == _MAX_SLIDE_STEPS:
                for i in range(3):
                    force[i] = trial_force[i]
                _set_identity(work.force_projection)
                return STICKS
            position[0], position[1], position[2] = s0, s1, s2
            continue
        _project_to_cone_surface(
            trial_force, normal, mu, compliance, tangent, binormal, cone_force, free_motion
        )
        # Where the toe is under the projected force
        for i in range(3):
            offset[i] = cone_force[i] - trial_force[i]
        _apply_matrix(compliance, offset, free_motion)
        x, y, z = s0 + free_motion[0], s1 + free_motion[1], s2 + free_motion[2]
        change = max(abs(x - position[0]), abs(y - position[1]), abs(z - position[2]))
        if change < _POSITION_TOLERANCE or attempt == _MAX_SLIDE_STEPS:
            break
        position[0], position[1], position[2] = x, y, z
    for i in range(3):
        force[i] = cone_force[i]
    _project_changes(force, normal, mu, work)
    return SLIDES


@compiled
def _lifts_off(free_motion: Array, normal: Array, mu: float) -> bool:
    """Return whether the motion of a toe without contact is in the polar cone of the friction cone.

    It leaves the surface at least by mu times what it slides.
    """
    lift_off = -_dot(free_motion, normal)
    sliding = 0.0
    for i in range(3):
        sliding += (free_motion[i] + lift_off * normal[i]) ** 2
    return bool(lift_off >= mu * np.sqrt(sliding))


@compiled
def _project_changes(force: Array, normal: Array, mu: float, work: ScratchMemory) -> None:
    """Project changes of a force on the cone to its tangent plane there: P, and P G in place of G.

    The projection is along G times the normal of the cone.
    """
    projection, stiffness = work.force_projection, work.contact_stiffness
    cone_normal = work.vectors[rows.CONE_NORMAL]
    stiffness_normal = work.vectors[rows.STIFFNESS_NORMAL]
    press = _dot(force, normal)
    for i in range(3):
        # Against the shear, and off the surface
        cone_normal[i] = mu * normal[i] - (force[i] - press * normal[i]) / max(mu * press, 1e-12)
    _apply_matrix(stiffness, cone_normal, stiffness_normal)
    curvature = max(_dot(cone_normal, stiffness_normal), 1e-9)
    for i in range(3):
        for j in range(3):
            projection[i, j] = (1.0 if i == j else 0.0) - stiffness_normal[i] * cone_normal[
                j
            ] / curvature
            stiffness[i, j] -= stiffness_normal[i] * stiffness_normal[j] / curvature


@compiled
def _solve_contact(
    body: BodyState,
    zero: Array,
    limb: int,
    mu: float,
    settings: StepSettings,
    ground: TerrainGeometry,
    springs: JointSprings,
    solution: ContactSolution,
    work: ScratchMemory,
) -> int:
    """Solve the contact of a limb's toe, which starts at its position in `solution`.

    Updates position, joint angles and force of the limb in `solution`. Leaves the matrices P and G
    of the force's change in `work.force_projection` and `work.contact_stiffness`: if the body moves
    by (dc, dw), then dF = -G dc + (G [r]x - P [f]x) dw. zero: (2n + 1, 3) of the limb at zero
    angles. Returns AIR, STICKS, SLIDES or FAILED.
    """
    if settings.project_forces:
        return _project_contact(body, zero, limb, mu, springs, solution, work)
    position, normal, force = solution.position[limb], solution.normal[limb], solution.force[limb]
    solid, face = solution.solid[limb], solution.face[limb]
    stiffness = work.contact_stiffness
    direction = work.vectors[rows.SLIDE_DIRECTION]
    stiffness_direction = work.vectors[rows.STIFFNESS_DIRECTION]
    has_slid = False
    for attempt in range(_MAX_SLIDE_STEPS + 1):
        if not _compute_toe_force(body, zero, limb, springs, solution, work):
            return FAILED
        press, shear = _decompose_force(force, normal, direction)
        # A toe without pressure at its anchor may still press where it slides to
        if press <= 0.0 and attempt > 1:
            return AIR
        if press <= 0.0 and shear < _DETACHMENT_SHEAR_RATIO * -press:
            return AIR
        excess = shear - mu * press
        if not has_slid and excess <= 0.0:
            _set_identity(work.force_projection)
            return STICKS
        _apply_matrix(stiffness, direction, stiffness_direction)
        tangential = _dot(direction, stiffness_direction)
        slide_stiffness = tangential + mu * _dot(normal, stiffness_direction)
        # If pressure grows as the toe slides the stiffness may vanish: bounded below, the toe
        # slides in small steps
        slide_stiffness = max(slide_stiffness, _MIN_SLIDE_STIFFNESS * abs(tangential) + 1e-6)
        if attempt == _MAX_SLIDE_STEPS or abs(excess) < _FRICTION_TOLERANCE * (
            mu * abs(press) + 0.01
        ):
            _release_sliding(direction, stiffness_direction, normal, mu, slide_stiffness, work)
            return SLIDES
        has_slid = True
        length = min(max(excess / slide_stiffness, -_MAX_SLIDE_STEP), _MAX_SLIDE_STEP)
        for i in range(3):
            position[i] += length * direction[i]
        _project_to_surface(position, solid, face, ground, normal)
    return FAILED


@compiled
def _decompose_force(force: Array, normal: Array, direction: Array) -> tuple[float, float]:
    """Return pressure and shear of a force (3,), and leave the unit vector against the shear."""
    press = _dot(force, normal)
    for i in range(3):
        direction[i] = force[i] - press * normal[i]
    shear = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    for i in range(3):
        direction[i] = -direction[i] / max(shear, 1e-12)
    return press, shear


@compiled
def _release_sliding(
    direction: Array,
    stiffness_direction: Array,
    normal: Array,
    mu: float,
    slide_stiffness: float,
    work: ScratchMemory,
) -> None:
    """Release the force of a sliding toe along its direction e: G becomes P G with the matrix

    P = I - G e (e + mu n)^T / slide_stiffness.
    """
    projection, stiffness = work.force_projection, work.contact_stiffness
    full_stiffness = work.matrices[rows.FULL_STIFFNESS]
    for i in range(3):
        for j in range(3):
            full_stiffness[i, j] = stiffness[i, j]
            projection[i, j] = (1.0 if i == j else 0.0) - stiffness_direction[i] * (
                direction[j] + mu * normal[j]
            ) / slide_stiffness
    for i in range(3):
        for j in range(3):
            stiffness[i, j] = (
                projection[i, 0] * full_stiffness[0, j]
                + projection[i, 1] * full_stiffness[1, j]
                + projection[i, 2] * full_stiffness[2, j]
            )
