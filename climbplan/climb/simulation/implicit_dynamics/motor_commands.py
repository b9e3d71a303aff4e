"""Commands of the motors in a time step, and the joint springs that result from them."""

from __future__ import annotations

import numpy as np

from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import (
    BACKLASH_STIFFNESS_RATIO,
    _compute_toe_compliance,
)
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import _copy_rows
from climbplan.climb.simulation.implicit_dynamics.regulation import (
    _add_foothold_errors,
    _add_offset_commands,
    _compute_delayed_offsets,
    _estimate_pose,
    _read_sensors,
    _update_offsets,
)
from climbplan.climb.simulation.implicit_dynamics.state import (
    BY_JOINTS,
    BY_POSE,
    NO_REGULATOR,
    BodyState,
    ContactSolution,
    JointSprings,
    MotorState,
    PlannedMotion,
    RegulatorState,
    RobotParameters,
    ScratchMemory,
    TimeStep,
)


@compiled
def _compute_commands(
    motion: PlannedMotion,
    robot: RobotParameters,
    step: TimeStep,
    body: BodyState,
    motors: MotorState,
    regulator: RegulatorState,
    work: ScratchMemory,
) -> None:
    """Compute the set points of motors at the end of a time step.

    They are the planned commands with the errors of footholds and the regulator's corrections.
    """
    s, previous, progress = (
        step.planned_step,
        max(step.planned_step - 1, 0),
        step.elapsed + step.fraction,
    )
    reference = motors.reference
    for i in range(len(reference)):
        for j in range(reference.shape[1]):
            reference[i, j] = (1 - progress) * motion.command[previous, i, j] + (
                progress * motion.command[s, i, j]
            )
    _add_foothold_errors(motion, s, robot.foothold_error, reference, work)
    if robot.regulator == NO_REGULATOR:
        return
    if not step.is_moving:
        _add_offset_commands(motion, s, regulator.offset, reference)
        _copy_rows(reference, regulator.command)
        return
    _read_sensors(motors.rotor_angle, robot.sensor_noise, step.span, regulator)
    for i in range(len(reference)):
        for j in range(reference.shape[1]):
            feedforward = motion.feedforward[previous, i, j]
            regulator.joint_error[i, j] = (
                regulator.mean_reading[i, j] - regulator.last_command[i, j] + feedforward
            )
    correct_position = robot.regulator == BY_JOINTS or robot.regulator == BY_POSE
    com, rotation = body.com, body.rotation
    if robot.regulator == BY_JOINTS:
        _estimate_pose(motion, previous, regulator, work)
        com, rotation = regulator.com, regulator.rotation
    _update_offsets(motion, step, correct_position, com, rotation, regulator, work)
    if robot.delay > 0.0:
        now = step.clock + step.span
        _compute_delayed_offsets(now - robot.delay, now, regulator)
        _add_offset_commands(motion, previous, regulator.delayed_offset, reference)
    else:
        _add_offset_commands(motion, previous, regulator.offset, reference)
    _copy_rows(reference, regulator.command)


@compiled
def _update_springs(
    motion: PlannedMotion,
    robot: RobotParameters,
    span: float,
    springs: JointSprings,
    solution: ContactSolution,
    motors: MotorState,
) -> None:
    """Compute the joint springs that motors are in an implicit step of span [s].

    Damping c and rotor inertia I add stiffness c / h and I / h^2 and shift the command.
    """
    rotor, reference = motors.rotor_angle, motors.reference
    for i in range(len(reference)):
        springs.toe_compliance[i] = _compute_toe_compliance(
            motion.zero_pose[i], reference.shape[1], springs.jacobian_volume[i]
        )
        solution.saturated[i] = 0
        for j in range(reference.shape[1]):
            k, c = robot.stiffness[i, j], robot.damping[i, j] / span
            m = robot.armature[i, j] / span**2
            total_stiffness = k + c + m
            # The torque limit bounds the distance between command and rotor
            max_lead = robot.max_torque[i, j] / k
            lead = rotor[i, j] - reference[i, j]
            if abs(lead) > max_lead:
                solution.saturated[i] = 1
                reference[i, j] = rotor[i, j] - np.copysign(max_lead, lead)
            springs.stiffness[i, j], springs.backlash_stiffness[i, j] = (
                total_stiffness,
                BACKLASH_STIFFNESS_RATIO * total_stiffness,
            )
            springs.command[i, j] = (
                k * reference[i, j]
                + c * rotor[i, j]
                + m * (rotor[i, j] + span * motors.rotor_speed[i, j])
            ) / total_stiffness
            solution.angles[i, j] = motors.joint_angle[i, j]
