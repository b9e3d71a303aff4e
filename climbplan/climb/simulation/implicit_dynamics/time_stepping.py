"""Simulate a plan in one scenario with adaptive time steps, to its end or to a fall.

Each step solves an implicit equilibrium (`implicit_step.py`). A step without a solution is halved;
after success the next one doubles.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.contact import AIR, SLIDES
from climbplan.climb.simulation.implicit_dynamics.corner_contact import _find_obstacle_hit
from climbplan.climb.simulation.implicit_dynamics.implicit_step import _solve_step
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import (
    BACKLASH_STIFFNESS_RATIO,
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
    BodyLoad,
    BodyState,
    ContactSolution,
    ContactState,
    FootSlip,
    JointSprings,
    MotorState,
    PlannedMotion,
    RegulatorState,
    RobotParameters,
    ScratchMemory,
    StepSettings,
    TerrainGeometry,
)
from climbplan.climb.simulation.implicit_dynamics.surfaces import (
    EDGE_TOLERANCE,
    _find_first_hit,
    _has_left_face,
    _project_to_surface,
)

NUM_SETTLING_STEPS = 4  # at the first commands, before the motion starts
SETTLING_SPAN = 0.25  # [s] of each
_MAX_LANDING_SPAN = 0.005  # [s] longest step in which a toe may land wherever its command goes
_PROJECTION_SPAN = 0.05  # [s] steps below project contact forces
_MAX_SLIDING_SPAN = 0.03  # [s] longest step while a toe slides: it changes direction on the way
_ROUGH_SPAN = 2e-3  # [s] steps below accept rough equilibria: toes snap
_HISTORY_LENGTH = 2048  # corrections in the ring buffer of a delayed regulator
MIN_STEP_FRACTION = 1.0 / 512  # of a planned step; shorter ones are not divided
_CONTACT_TOLERANCE = 1e-5  # [m] from a surface at which a toe starts in contact


@compiled
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
    n, joints = motion.command.shape[1], motion.command.shape[2]
    work = ScratchMemory(
        np.zeros(6), np.zeros((6, 6)), np.zeros(6), np.zeros((3, 3)), np.zeros((3, 3)),
        np.zeros((joints, 3)), np.zeros((joints, 3)), np.zeros((12, 3)), np.zeros((6, 3, 3)),
        np.zeros((4, joints)), np.zeros((joints, 3)), np.zeros((joints, joints)),
    )  # fmt: skip
    body = BodyState(motion.com[0].copy(), motion.rotation[0].copy(), np.zeros(6), np.zeros(6))
    saved_body = BodyState(
        motion.com[0].copy(), motion.rotation[0].copy(), np.zeros(6), np.zeros(6)
    )
    half_backlash = robot.backlash / (2 * (1 - BACKLASH_STIFFNESS_RATIO))
    springs = JointSprings(
        np.zeros((n, joints)), np.zeros((n, joints)), np.zeros((n, joints)), half_backlash,
        np.zeros((n, joints)), np.zeros(n), np.zeros(n),
    )  # fmt: skip
    for i in range(n):
        _compute_kinematics(
            motion.zero_pose[i],
            robot.initial_angles[i],
            work.jacobian,
            work.joint_axes,
            work.vectors[0],
        )
        springs.jacobian_volume[i] = _compute_jacobian_volume(work.jacobian)
    contacts = ContactState(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64),
        robot.initial_toes.copy(), np.zeros(n, np.int64), np.full((n, 2), -1),
    )  # fmt: skip
    solution = ContactSolution(
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64),
        robot.initial_toes.copy(), np.zeros((n, 3)), np.zeros((n, 3)),
        robot.initial_angles.copy(), np.zeros(n, np.int64),
    )  # fmt: skip
    load = BodyLoad(robot.mass, robot.inertia, robot.gravity, robot.mass_offset, np.zeros(6))
    motors = MotorState(
        robot.initial_angles.copy(),
        robot.initial_angles.copy(),
        np.zeros((n, joints)),
        np.zeros((n, joints)),
    )
    regulator = RegulatorState(
        robot.initial_toes.copy(), motion.trusted[0].copy(), motion.com[0].copy(),
        motion.rotation[0].copy(), robot.initial_toes - motion.initial_toes,
        robot.initial_toes - motion.initial_toes, motion.command[0].copy(),
        motion.command[0].copy(), np.zeros((n, joints)), np.zeros((n, 3)), np.zeros((n, 3)),
        np.zeros((n, joints)), np.zeros((n, joints)), np.zeros(1, np.int64), np.zeros((n, 3)),
        np.zeros(_HISTORY_LENGTH), np.zeros((_HISTORY_LENGTH if robot.delay > 0.0 else 0, n, 3)),
        np.zeros(1, np.int64),
    )  # fmt: skip
    slip = FootSlip(robot.initial_toes.copy(), np.zeros(n))
    row = np.zeros(COLUMNS)
    row[CAUSE_LIMB] = -1
    for i in range(n):
        g, f, _ = _find_first_hit(
            contacts.anchor[i], contacts.anchor[i], ground, _CONTACT_TOLERANCE, int(np.int64(-1))
        )
        if g >= 0:
            contacts.in_contact[i], contacts.solid[i], contacts.face[i] = 1, g, f
            _project_to_surface(contacts.anchor[i], g, f, ground, solution.normal[i])
    _advance_motion(
        motion, robot, ground, path, row, body, saved_body, load, springs, contacts, solution,
        motors, regulator, slip, work,
    )  # fmt: skip
    return row


@compiled
def _advance_motion(
    motion: PlannedMotion,
    robot: RobotParameters,
    ground: TerrainGeometry,
    path: Array,
    row: Array,
    body: BodyState,
    saved_body: BodyState,
    load: BodyLoad,
    springs: JointSprings,
    contacts: ContactState,
    solution: ContactSolution,
    motors: MotorState,
    regulator: RegulatorState,
    slip: FootSlip,
    work: ScratchMemory,
) -> None:
    """Advance all steps of `simulate_motion`, which allocates the arrays, and fill the outcome."""
    max_fraction, clock = 1.0, 0.0
    if robot.delay > 0.0:
        _record_offsets(clock, regulator)
    for index in range(-NUM_SETTLING_STEPS, len(motion.duration)):
        s = max(index, 0)
        full_span = SETTLING_SPAN if index <= 0 else motion.duration[s]
        for a in range(6):
            load.external_wrench[a] = motion.external_wrench[s, a]
        for i in range(len(motors.rotor_angle)):
            for j in range(motors.rotor_angle.shape[1]):
                springs.gravity_torque[i, j] = motion.gravity_torque[s, i, j]
        if index > 0 and len(motion.contact_points):
            _roll_contacts(motion, s, body, contacts, ground, motors, regulator, slip, work)
        _apply_friction_losses(robot, s, index > 0, contacts)
        elapsed = 0.0
        while elapsed < 1.0 - 1e-9:
            fraction = min(
                max_fraction,
                1.0 - elapsed,
                _MAX_SLIDING_SPAN / full_span if _is_sliding(solution) else 1.0,
            )
            if 1.0 - elapsed - fraction < 1e-6:
                fraction = 1.0 - elapsed
            span = fraction * full_span
            settings = StepSettings(
                span, span < _PROJECTION_SPAN, span > _MAX_LANDING_SPAN, span < _ROUGH_SPAN
            )
            _compute_commands(
                motion,
                robot,
                s,
                elapsed,
                fraction,
                span,
                index > 0,
                clock,
                body,
                motors,
                regulator,
                work,
            )
            _update_springs(motion, robot, span, springs, solution, motors)
            _copy_body(body, saved_body)
            has_converged = _solve_step(
                body,
                settings,
                load,
                motion.zero_pose,
                contacts,
                ground,
                springs,
                solution,
                work,
            )
            if not has_converged:
                _copy_body(saved_body, body)
                _copy_rows(regulator.accepted_offset, regulator.offset)
                max_fraction = fraction / 2
                if max_fraction >= MIN_STEP_FRACTION:
                    continue
                row[LOST_BALANCE] = 1
                _record_fall(s, row)
                return
            _copy_rows(regulator.command, regulator.last_command)
            _copy_rows(regulator.offset, regulator.accepted_offset)
            if robot.delay > 0.0 and index > 0:
                clock += span
                _record_offsets(clock, regulator)
            elapsed += fraction
            max_fraction = (
                min(1.0, 2 * fraction) if elapsed < 1.0 - 1e-9 else min(1.0, 2 * max_fraction)
            )
            for a in range(6):
                body.velocity[a] = body.displacement[a] / span
            _accept_step(
                motion, body, contacts, ground, springs, solution, motors, span, slip, work
            )
        if len(path):
            _record_sample(body, solution, path[s])
        _update_outcome(motion, s, ground, solution, slip, row)
        if _has_fallen(motion, s, body, row):
            _record_fall(s, row)
            return


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
    body: BodyState,
    contacts: ContactState,
    ground: TerrainGeometry,
    springs: JointSprings,
    solution: ContactSolution,
    motors: MotorState,
    span: float,
    slip: FootSlip,
    work: ScratchMemory,
) -> None:
    """Update contacts, slip and motors from the solution of a step, in place."""
    angles, rotor_angle, slid = motors.joint_angle, motors.rotor_angle, slip.distance
    for i in range(len(angles)):
        place = solution.position[i]
        if solution.mode[i] == AIR:
            contacts.corner_face[i, 0] = -1
            # Without contact force the joints rest at the ends of their backlash
            _compute_free_angles(i, springs, solution.angles[i])
            _compute_kinematics(
                motion.zero_pose[i],
                solution.angles[i],
                work.jacobian,
                work.joint_axes,
                work.vectors[0],
            )
            springs.jacobian_volume[i] = _compute_jacobian_volume(work.jacobian)
            _apply_matrix(body.rotation, work.vectors[0], place)
            for a in range(3):
                place[a] += body.com[a]
            contacts.in_contact[i] = 0
            slid[i] = 0.0
        else:
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
            slid[i] = np.sqrt(distance)
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
        for a in range(3):
            contacts.anchor[i, a] = place[a]
