"""Solve one implicit time step of a robot in contact, by Newton's method in the pose of its body.

The integrator is backward Euler. With step length h a motor's torque
k (theta - command) + c dtheta/dt + I d2theta/dt2 is that of a spring of stiffness k + c/h + I/h^2
about a shifted command. Each step therefore is an equilibrium: find the translation and rotation x
of the body at the end of the step such that

    sum of contact wrenches(x) + weight + external wrench = M (x - h v) / h^2.

Long steps are quasi-static, short ones dynamic. A robot without an equilibrium falls.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.contact import AIR, FAILED, STICKS, _solve_contact
from climbplan.climb.simulation.implicit_dynamics.corner_contact import (
    _find_obstacle_hit,
    _solve_corner_contact,
)
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import (
    _compute_free_angles,
    _compute_kinematics,
)
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import (
    _apply_matrix,
    _cross,
    _rotate,
    _solve_positive_definite,
)
from climbplan.climb.simulation.implicit_dynamics.state import (
    BodyLoad,
    BodyState,
    ContactSolution,
    ContactState,
    ScratchMemory,
    SimulationState,
    StepSettings,
    TerrainGeometry,
)
from climbplan.climb.simulation.implicit_dynamics.surfaces import (
    TUBE,
    _find_first_hit,
    _project_to_surface,
)

_MAX_ITERATIONS = 30
_TOLERANCE = 2e-4  # residual by the weight; moments count at _MOMENT_ARM
_ROUGH_FACTOR = 500.0  # times the tolerance, for rough solutions
_MOMENT_ARM = 0.3  # [m]
_MAX_TRANSLATION, _MAX_ROTATION = 0.03, 0.06  # [m], [rad] Newton step limits
MAX_OVERSHOOT = 5e-4  # [m] that a toe may move beyond a surface that it reaches in a step
_MAX_HALVINGS = 5  # of a Newton step that increases the residual, in a row
_MAX_LANDING_SPAN = 0.005  # [s] longest step in which a toe may land wherever its command goes
_PROJECTION_SPAN = 0.05  # [s] steps below project contact forces
_ROUGH_SPAN = 2e-3  # [s] steps below accept rough equilibria: toes snap


@compiled
def _compute_contact_wrench(
    zero: Array,
    ground: TerrainGeometry,
    settings: StepSettings,
    state: SimulationState,
    work: ScratchMemory,
) -> bool:
    """Solve all contacts; sum their wrenches in `work.residual` and stiffness in `work.stiffness`.

    zero: (N, 2J + 1, 3) limbs at zero angles. Returns False if a limb cannot reach its contact
    point, or if a toe lands in a step that is too long to locate the touchdown.
    """
    body, contacts, springs, solution = state.body, state.contacts, state.springs, state.solution
    work.residual[:] = 0.0
    work.stiffness[:] = 0.0
    toe_body = work.vectors[rows.TOE]
    for i in range(len(zero)):
        position = solution.position[i]
        if contacts.in_contact[i]:
            g, f = contacts.solid[i], contacts.face[i]
            for a in range(3):
                position[a] = contacts.anchor[i, a]
        else:
            _compute_free_angles(i, springs, solution.angles[i])
            _compute_kinematics(
                zero[i], solution.angles[i], work.jacobian, work.joint_axes, toe_body
            )
            _apply_matrix(body.rotation, toe_body, position)
            for a in range(3):
                position[a] += body.com[a]
            g, f, overshoot = _find_touchdown(contacts.anchor[i], position, ground)
            if g < 0:
                solution.mode[i] = AIR
                solution.force[i] = 0.0
                continue
            if settings.forbid_landing and overshoot > MAX_OVERSHOOT**2:
                return False
        solution.solid[i], solution.face[i] = g, f
        _project_to_surface(position, g, f, ground, solution.normal[i])
        friction = ground.tube_friction[g] if f == TUBE else ground.friction[g]
        if contacts.frictionless[i]:
            friction = 0.0
        if contacts.corner_face[i, 0] >= 0 and _solve_corner_contact(
            body, zero[i], i, friction, contacts, ground, springs, solution, work
        ):
            mode = STICKS
        else:
            mode = _solve_contact(
                body, zero[i], i, friction, settings, ground, springs, solution, work
            )
        if mode == FAILED:
            return False
        solution.mode[i] = mode
        if mode == AIR:
            solution.force[i] = 0.0
            continue
        _add_wrench(position, solution.force[i], body, work)
    return True


@compiled
def _find_touchdown(
    anchor: Array, position: Array, ground: TerrainGeometry
) -> tuple[int, int, float]:
    """Return solid and face that a toe reaches on its way, -1 if none, and the squared overshoot.

    The overshoot is the rest of the way from the touchdown to the commanded position.
    """
    g, f, fraction = _find_first_hit(anchor, position, ground, 0.0, int(np.int64(-1)))
    overshoot = 0.0  # [m^2]
    for a in range(3):
        overshoot += ((1 - fraction) * (position[a] - anchor[a])) ** 2
    return g, f, overshoot


@compiled
def _add_wrench(position: Array, force: Array, body: BodyState, work: ScratchMemory) -> None:
    """Add the wrench of one contact to `work.residual`, and its stiffness to `work.stiffness`."""
    arm, moment = work.vectors[rows.MOMENT_ARM], work.vectors[rows.MOMENT]
    for a in range(3):
        arm[a] = position[a] - body.com[a]
        work.residual[a] += force[a]
    _cross(arm, force, moment)
    for a in range(3):
        work.residual[3 + a] += moment[a]
    _add_stiffness(arm, force, work, work.stiffness)


@compiled
def _add_stiffness(arm: Array, force: Array, work: ScratchMemory, matrix: Array) -> None:
    """Add the stiffness -d(force, moment) / d(translation c, rotation w) of one contact.

    dF = -G dc + (G [r]x - P [f]x) dw and dM = r x dF + f x dc, with G the contact stiffness and P
    the force projection of the contact.
    """
    stiffness, projection = work.contact_stiffness, work.force_projection
    block = work.matrices[rows.STIFFNESS_BLOCK]
    r0, r1, r2 = arm[0], arm[1], arm[2]
    f0, f1, f2 = force[0], force[1], force[2]
    for i in range(3):
        g0, g1, g2 = stiffness[i, 0], stiffness[i, 1], stiffness[i, 2]
        p0, p1, p2 = projection[i, 0], projection[i, 1], projection[i, 2]
        # Row of G [r]x - P [f]x
        block[i, 0] = g1 * r2 - g2 * r1 - (p1 * f2 - p2 * f1)
        block[i, 1] = g2 * r0 - g0 * r2 - (p2 * f0 - p0 * f2)
        block[i, 2] = g0 * r1 - g1 * r0 - (p0 * f1 - p1 * f0)
    for j in range(3):
        for i in range(3):
            matrix[i, j] += stiffness[i, j]
            matrix[i, 3 + j] -= block[i, j]
        # -(r x column): of -G for dc, of block for dw
        matrix[3, j] += r1 * stiffness[2, j] - r2 * stiffness[1, j]
        matrix[4, j] += r2 * stiffness[0, j] - r0 * stiffness[2, j]
        matrix[5, j] += r0 * stiffness[1, j] - r1 * stiffness[0, j]
        matrix[3, 3 + j] -= r1 * block[2, j] - r2 * block[1, j]
        matrix[4, 3 + j] -= r2 * block[0, j] - r0 * block[2, j]
        matrix[5, 3 + j] -= r0 * block[1, j] - r1 * block[0, j]
    # -[f]x of the moment by dc
    matrix[3, 1] += f2
    matrix[3, 2] -= f1
    matrix[4, 0] -= f2
    matrix[4, 2] += f0
    matrix[5, 0] += f1
    matrix[5, 1] -= f0


@compiled
def _has_overshot(
    contacts: ContactState, ground: TerrainGeometry, solution: ContactSolution
) -> bool:
    """Return whether a toe has slid too deep into a solid to locate its stop in a long step."""
    deepest = 0.0
    for i in range(len(solution.mode)):
        deepest = max(deepest, _find_obstacle_hit(i, contacts, ground, solution)[2])
    return deepest > MAX_OVERSHOOT


@compiled
def _solve_step(
    zero: Array, ground: TerrainGeometry, span: float, state: SimulationState, work: ScratchMemory
) -> bool:
    """Move a body to its equilibrium at the end of a time step, in place.

    Newton's method with limited steps; a step that increases the residual is halved, as contacts
    and backlash have kinks. Returns False without an equilibrium, if it is unstable, or after an
    overshoot; a small residual at the iteration limit counts as an equilibrium.

    zero: (N, 2J + 1, 3) limbs at zero angles. span: of the step [s].
    """
    body, load = state.body, state.load
    settings = StepSettings(
        span, span < _PROJECTION_SPAN, span > _MAX_LANDING_SPAN, span < _ROUGH_SPAN
    )
    residual, newton_step = work.residual, work.newton_step
    gravity_force = work.vectors[rows.GRAVITY_FORCE]
    gravity_force[0], gravity_force[1], gravity_force[2] = 0.0, 0.0, -load.mass * load.gravity
    tolerance = _TOLERANCE * load.mass * load.gravity
    _extrapolate_motion(body, span)
    error, previous_error, num_halvings = np.inf, np.inf, 0
    for _ in range(_MAX_ITERATIONS):
        if not _compute_contact_wrench(zero, ground, settings, state, work):
            return False
        error = _add_loads(body, span, load, gravity_force, work)
        if error < tolerance:
            return not (
                settings.forbid_landing and _has_overshot(state.contacts, ground, state.solution)
            )
        if error > previous_error and num_halvings < _MAX_HALVINGS:
            num_halvings += 1
            _halve_step(body, newton_step, work.vectors[rows.ROTATION_STEP])
            continue
        previous_error, num_halvings = error, 0
        if not _solve_positive_definite(work.stiffness, residual):
            return False
        excess = 0.0
        for a in range(3):
            excess = max(
                excess, abs(residual[a]) / _MAX_TRANSLATION, abs(residual[3 + a]) / _MAX_ROTATION
            )
        scale = 1.0 if excess <= 1.0 else 1.0 / excess
        for a in range(6):
            residual[a] *= scale
            body.displacement[a] += residual[a]
            newton_step[a] = residual[a]
        for a in range(3):
            body.com[a] += residual[a]
        _rotate(body.rotation, residual[3:])
    return settings.accept_rough and error < _ROUGH_FACTOR * tolerance


@compiled
def _extrapolate_motion(body: BodyState, span: float) -> None:
    """Move a body by its velocity over a span [s], at most 5 mm and 0.01 rad on each axis."""
    displacement, velocity = body.displacement, body.velocity
    for a in range(3):
        displacement[a] = min(max(velocity[a] * span, -0.005), 0.005)
        displacement[3 + a] = min(max(velocity[3 + a] * span, -0.01), 0.01)
        body.com[a] += displacement[a]
    _rotate(body.rotation, displacement[3:])


@compiled
def _add_loads(
    body: BodyState, span: float, load: BodyLoad, gravity_force: Array, work: ScratchMemory
) -> float:
    """Add weight, external wrench and inertia to residual and stiffness; return the error [N].

    The error is the largest component of the residual, moments divided by _MOMENT_ARM.
    """
    residual, matrix = work.residual, work.stiffness
    velocity, displacement = body.velocity, body.displacement
    lever, moment = work.vectors[rows.MOMENT_ARM], work.vectors[rows.MOMENT]
    mass, inertia = load.mass / span**2, load.inertia / span**2
    _apply_matrix(body.rotation, load.mass_offset, lever)
    _cross(lever, gravity_force, moment)
    for a in range(3):
        residual[a] += (
            load.external_wrench[a]
            + gravity_force[a]
            + mass * (velocity[a] * span - displacement[a])
        )
        residual[3 + a] += (
            load.external_wrench[3 + a]
            + moment[a]
            + inertia * (velocity[3 + a] * span - displacement[3 + a])
        )
        matrix[a, a] += mass
        matrix[3 + a, 3 + a] += inertia
    # (dw x q) x W = q (dw . W) - dw (q . W)
    for a in range(3):
        matrix[3 + a, 5] -= lever[a] * gravity_force[2]
        matrix[3 + a, 3 + a] += lever[2] * gravity_force[2]
    error = 0.0
    for a in range(3):
        error = max(error, abs(residual[a]), abs(residual[3 + a]) / _MOMENT_ARM)
    return error


@compiled
def _halve_step(body: BodyState, newton_step: Array, rotation_step: Array) -> None:
    """Move a body back by half of its last Newton step (6,), which is halved in place."""
    for a in range(6):
        newton_step[a] *= 0.5
        body.displacement[a] -= newton_step[a]
    for a in range(3):
        body.com[a] -= newton_step[a]
        rotation_step[a] = -newton_step[3 + a]
    _rotate(body.rotation, rotation_step)
