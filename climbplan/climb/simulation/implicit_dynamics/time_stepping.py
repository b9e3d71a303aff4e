"""Simulate a plan in one scenario with adaptive time steps, to its end or to a fall.

Each step solves an implicit equilibrium (`implicit_step.py`). A step without a solution is halved;
after success the next one doubles.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.contact import AIR, SLIDES
from climbplan.climb.simulation.implicit_dynamics.corner_contact import _find_obstacle_hit
from climbplan.climb.simulation.implicit_dynamics.implicit_step import _solve_step
from climbplan.climb.simulation.implicit_dynamics.initial_state import (
    create_memory,
    create_state,
)
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import (
    _compute_free_angles,
    _compute_jacobian_volume,
    _compute_kinematics,
    _compute_spring_torque,
)
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import _apply_matrix, _copy_rows
from climbplan.climb.simulation.implicit_dynamics.motor_commands import (
    _compute_commands,
    _update_springs,
)
from climbplan.climb.simulation.implicit_dynamics.outcome import (
    CAUSE_LIMB,
    COLUMNS,
    LOST_BALANCE,
    _has_fallen,
    _record_fall,
    _record_sample,
    _update_outcome,
)
from climbplan.climb.simulation.implicit_dynamics.regulation import (
    _record_offsets,
)
from climbplan.climb.simulation.implicit_dynamics.rolling_contact import _roll_contacts
from climbplan.climb.simulation.implicit_dynamics.state import (
    BodyState,
    ContactSolution,
    ContactState,
    FootSlip,
    JointSprings,
    MotorState,
    PlannedMotion,
    RobotParameters,
    ScratchMemory,
    SimulationState,
    TerrainGeometry,
    TimeStep,
)
from climbplan.climb.simulation.implicit_dynamics.surfaces import (
    EDGE_TOLERANCE,
    _find_first_hit,
    _has_left_face,
    _project_to_surface,
)

NUM_SETTLING_STEPS = 4  # at the first commands, before the motion starts
SETTLING_SPAN = 0.25  # [s] of each
_MAX_SLIDING_SPAN = 0.03  # [s] longest step while a toe slides: it changes direction on the way
MIN_STEP_FRACTION = 1.0 / 512  # of a planned step; shorter ones are not divided
_CONTACT_TOLERANCE = 1e-5  # [m] from a surface at which a toe starts in contact


def simulate_motion(
    motion: PlannedMotion, robot: RobotParameters, ground: TerrainGeometry, path: Array
) -> Array:
    """Simulate a motion in one scenario and return its outcome.

    Args:
        motion: The plan's motion in S steps.
        robot: The robot as it is in the scenario.
        ground: The terrain as it is in the scenario.
        path: (S, 3 + 6 N) filled with the body's position, the toes [m] and the forces on them [N],
            world frame; (0, 3 + 6 N) records nothing.

    Returns:
        (COLUMNS,) the outcome, with the columns of `outcome.py`.
    """
    row = np.zeros(COLUMNS)
    row[CAUSE_LIMB] = -1
    work = create_memory(motion.command.shape[2])
    run_motion(motion, robot, ground, path, row, create_state(motion, robot), work)
    return row


@compiled
def run_motion(
    motion: PlannedMotion,
    robot: RobotParameters,
    ground: TerrainGeometry,
    path: Array,
    row: Array,
    state: SimulationState,
    work: ScratchMemory,
) -> None:
    """Run all steps of `simulate_motion`, and fill path (S, 3 + 6 N) and outcome (COLUMNS,)."""
    _set_up_limbs(motion, ground, state, work)
    max_fraction, clock = 1.0, 0.0
    if robot.delay > 0.0:
        _record_offsets(clock, state.regulator)
    for index in range(-NUM_SETTLING_STEPS, len(motion.duration)):
        s, is_moving = max(index, 0), index > 0
        for a in range(6):
            state.load.external_wrench[a] = motion.external_wrench[s, a]
        _copy_rows(motion.gravity_torque[s], state.springs.gravity_torque)
        if is_moving and len(motion.contact_points):
            _roll_contacts(motion, s, ground, state, work)
        _apply_friction_losses(robot, s, is_moving, state.contacts)
        has_balance, max_fraction, clock = _advance_planned_step(
            motion, robot, ground, s, is_moving, max_fraction, clock, state, work
        )
        if not has_balance:
            row[LOST_BALANCE] = 1
            _record_fall(s, row)
            return
        if len(path):
            _record_sample(state.body, state.solution, path[s])
        _update_outcome(motion, s, ground, state.solution, state.slip, row)
        if _has_fallen(motion, s, state.body, row):
            _record_fall(s, row)
            return


@compiled
def _set_up_limbs(
    motion: PlannedMotion, ground: TerrainGeometry, state: SimulationState, work: ScratchMemory
) -> None:
    """Compute the Jacobians' volumes, and put toes on the surfaces that they start on."""
    contacts = state.contacts
    for i in range(len(contacts.anchor)):
        _compute_kinematics(
            motion.zero_pose[i],
            state.motors.joint_angle[i],
            work.jacobian,
            work.joint_axes,
            work.vectors[rows.TOE],
        )
        state.springs.jacobian_volume[i] = _compute_jacobian_volume(work.jacobian)
        g, f, _ = _find_first_hit(
            contacts.anchor[i], contacts.anchor[i], ground, _CONTACT_TOLERANCE, int(np.int64(-1))
        )
        if g >= 0:
            contacts.in_contact[i], contacts.solid[i], contacts.face[i] = 1, g, f
            _project_to_surface(contacts.anchor[i], g, f, ground, state.solution.normal[i])


@compiled
def _advance_planned_step(
    motion: PlannedMotion,
    robot: RobotParameters,
    ground: TerrainGeometry,
    s: int,
    is_moving: bool,
    max_fraction: float,
    clock: float,
    state: SimulationState,
    work: ScratchMemory,
) -> tuple[bool, float, float]:
    """Advance planned step s in time steps, which are halved until they have a solution.

    max_fraction: of the planned step, largest for its first time step. clock: time since the motion
    began [s]. Returns whether all time steps have a solution, and these two for the next.
    """
    body, regulator = state.body, state.regulator
    full_span = motion.duration[s] if is_moving else SETTLING_SPAN
    elapsed = 0.0
    while elapsed < 1.0 - 1e-9:
        fraction = _choose_fraction(elapsed, max_fraction, full_span, state.solution)
        step = TimeStep(s, elapsed, fraction, fraction * full_span, is_moving, clock)
        _compute_commands(motion, robot, step, body, state.motors, regulator, work)
        _update_springs(motion, robot, step.span, state.springs, state.solution, state.motors)
        _copy_body(body, state.saved_body)
        if not _solve_step(motion.zero_pose, ground, step.span, state, work):
            _copy_body(state.saved_body, body)
            _copy_rows(regulator.accepted_offset, regulator.offset)
            max_fraction = fraction / 2
            if max_fraction >= MIN_STEP_FRACTION:
                continue
            return False, max_fraction, clock
        _copy_rows(regulator.command, regulator.last_command)
        _copy_rows(regulator.offset, regulator.accepted_offset)
        if robot.delay > 0.0 and is_moving:
            clock += step.span
            _record_offsets(clock, regulator)
        elapsed += fraction
        max_fraction = (
            min(1.0, 2 * fraction) if elapsed < 1.0 - 1e-9 else min(1.0, 2 * max_fraction)
        )
        for a in range(6):
            body.velocity[a] = body.displacement[a] / step.span
        _accept_step(motion, ground, step.span, state, work)
    return True, max_fraction, clock


@compiled
def _choose_fraction(
    elapsed: float, max_fraction: float, full_span: float, solution: ContactSolution
) -> float:
    """Return the fraction of a planned step of full_span [s] that the next time step takes."""
    fraction = min(
        max_fraction,
        1.0 - elapsed,
        _MAX_SLIDING_SPAN / full_span if _is_sliding(solution) else 1.0,
    )
    return 1.0 - elapsed if 1.0 - elapsed - fraction < 1e-6 else fraction


@compiled
def _is_sliding(solution: ContactSolution) -> bool:
    """Return whether any toe slides."""
    is_sliding = False
    for i in range(len(solution.mode)):
        is_sliding = is_sliding or solution.mode[i] == SLIDES
    return is_sliding


@compiled
def _copy_body(source: BodyState, target: BodyState) -> None:
    """Copy the pose of one body to another."""
    for a in range(3):
        target.com[a] = source.com[a]
        for b in range(3):
            target.rotation[a, b] = source.rotation[a, b]


@compiled
def _apply_friction_losses(
    robot: RobotParameters, s: int, moves: bool, contacts: ContactState
) -> None:
    """Mark the toes that have no friction in a step."""
    for i in range(len(contacts.frictionless)):
        contacts.frictionless[i] = 0
    for loss in range(len(robot.friction_losses)):
        if moves and robot.friction_losses[loss, 1] <= s < robot.friction_losses[loss, 2]:
            contacts.frictionless[int(robot.friction_losses[loss, 0])] = 1


@compiled
def _accept_step(
    motion: PlannedMotion,
    ground: TerrainGeometry,
    span: float,
    state: SimulationState,
    work: ScratchMemory,
) -> None:
    """Update contacts, slip and motors from the solution of a step, in place."""
    for i in range(len(state.solution.mode)):
        if state.solution.mode[i] == AIR:
            _accept_free_limb(motion, i, state, work)
        else:
            _accept_contact(i, ground, state.contacts, state.solution, state.slip)
        _accept_rotors(i, span, state.springs, state.solution, state.motors)
        for a in range(3):
            state.contacts.anchor[i, a] = state.solution.position[i, a]


@compiled
def _accept_free_limb(
    motion: PlannedMotion, i: int, state: SimulationState, work: ScratchMemory
) -> None:
    """Place a limb in the air, whose joints rest at the ends of their backlash."""
    body, solution, contacts = state.body, state.solution, state.contacts
    place = solution.position[i]
    contacts.corner_face[i, 0] = -1
    _compute_free_angles(i, state.springs, solution.angles[i])
    toe_body = work.vectors[rows.TOE]
    _compute_kinematics(
        motion.zero_pose[i], solution.angles[i], work.jacobian, work.joint_axes, toe_body
    )
    state.springs.jacobian_volume[i] = _compute_jacobian_volume(work.jacobian)
    _apply_matrix(body.rotation, toe_body, place)
    for a in range(3):
        place[a] += body.com[a]
    contacts.in_contact[i] = 0
    state.slip.distance[i] = 0.0


@compiled
def _accept_contact(
    i: int,
    ground: TerrainGeometry,
    contacts: ContactState,
    solution: ContactSolution,
    slip: FootSlip,
) -> None:
    """Put a toe in contact on its surface: its last one, or one that it slid to or over an edge."""
    place = solution.position[i]
    g, f = solution.solid[i], solution.face[i]
    hit_solid, hit_face, overshoot = _find_obstacle_hit(i, contacts, ground, solution)
    if hit_solid >= 0:
        # The toe stops where it reaches the other surface
        distance = 0.0
        for a in range(3):
            distance += (place[a] - contacts.anchor[i, a]) ** 2
        for a in range(3):
            place[a] -= overshoot / np.sqrt(distance) * (place[a] - contacts.anchor[i, a])
        contacts.corner_face[i, 0], contacts.corner_face[i, 1] = g, f
        g, f = hit_solid, hit_face
    elif solution.mode[i] == SLIDES:
        contacts.corner_face[i, 0] = -1
    _project_to_surface(place, g, f, ground, solution.normal[i])
    if not contacts.in_contact[i]:
        for a in range(3):
            slip.touchdown[i, a] = place[a]
    contacts.in_contact[i], contacts.solid[i], contacts.face[i] = 1, g, f
    if _has_left_face(place, g, f, ground):
        g, f, _ = _find_first_hit(place, place, ground, EDGE_TOLERANCE, int(np.int64(-1)))
        if g < 0:
            contacts.in_contact[i] = 0
        else:
            contacts.solid[i], contacts.face[i] = g, f
            _project_to_surface(place, g, f, ground, solution.normal[i])
    distance = 0.0
    for a in range(3):
        distance += (place[a] - slip.touchdown[i, a]) ** 2
    slip.distance[i] = np.sqrt(distance)


@compiled
def _accept_rotors(
    i: int, span: float, springs: JointSprings, solution: ContactSolution, motors: MotorState
) -> None:
    """Update joint angles, rotor angles and rotor speeds of a limb."""
    angles, rotor_angle = motors.joint_angle, motors.rotor_angle
    for j in range(angles.shape[1]):
        angles[i, j] = solution.angles[i, j]
        deflection = angles[i, j] - springs.command[i, j]
        stiffness = springs.stiffness[i, j]
        torque = _compute_spring_torque(
            deflection, springs.half_backlash[i, j], springs.backlash_stiffness[i, j], stiffness
        )
        rotor = springs.command[i, j] + torque / stiffness
        motors.rotor_speed[i, j] = (rotor - rotor_angle[i, j]) / span
        rotor_angle[i, j] = rotor
