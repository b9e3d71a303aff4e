"""Allocate what a simulation changes in place: the state of the robot at its start, and memory."""

from __future__ import annotations

import numpy as np

from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import BACKLASH_STIFFNESS_RATIO
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
    SimulationState,
)

_HISTORY_LENGTH = 2048  # corrections in the ring buffer of a delayed regulator


def create_memory(joints: int) -> ScratchMemory:
    """Create the memory for limbs with a number of joints."""
    return ScratchMemory(
        residual=np.zeros(6),
        stiffness=np.zeros((6, 6)),
        newton_step=np.zeros(6),
        force_projection=np.zeros((3, 3)),
        contact_stiffness=np.zeros((3, 3)),
        jacobian=np.zeros((joints, 3)),
        joint_axes=np.zeros((joints, 3)),
        vectors=np.zeros((rows.NUM_VECTORS, 3)),
        matrices=np.zeros((rows.NUM_MATRICES, 3, 3)),
        joint_vectors=np.zeros((rows.NUM_JOINT_VECTORS, joints)),
        joint_response=np.zeros((joints, 3)),
        joint_matrix=np.zeros((joints, joints)),
    )


def create_state(motion: PlannedMotion, robot: RobotParameters) -> SimulationState:
    """Create the state of a robot at the start of a motion, at rest where it is set up."""
    n, joints = motion.command.shape[1:]
    springs = JointSprings(
        command=np.zeros((n, joints)),
        gravity_torque=np.zeros((n, joints)),
        stiffness=np.zeros((n, joints)),
        half_backlash=robot.backlash / (2 * (1 - BACKLASH_STIFFNESS_RATIO)),
        backlash_stiffness=np.zeros((n, joints)),
        jacobian_volume=np.zeros(n),
        toe_compliance=np.zeros(n),
    )
    contacts = ContactState(
        in_contact=np.zeros(n, np.int64),
        solid=np.zeros(n, np.int64),
        face=np.zeros(n, np.int64),
        anchor=robot.initial_toes.copy(),
        frictionless=np.zeros(n, np.int64),
        corner_face=np.full((n, 2), -1, np.int64),
    )
    solution = ContactSolution(
        mode=np.zeros(n, np.int64),
        solid=np.zeros(n, np.int64),
        face=np.zeros(n, np.int64),
        position=robot.initial_toes.copy(),
        normal=np.zeros((n, 3)),
        force=np.zeros((n, 3)),
        angles=robot.initial_angles.copy(),
        saturated=np.zeros(n, np.int64),
    )
    motors = MotorState(
        rotor_angle=robot.initial_angles.copy(),
        joint_angle=robot.initial_angles.copy(),
        rotor_speed=np.zeros((n, joints)),
        reference=np.zeros((n, joints)),
    )
    return SimulationState(
        body=_create_body(motion),
        saved_body=_create_body(motion),
        load=BodyLoad(robot.mass, robot.inertia, robot.gravity, robot.mass_offset, np.zeros(6)),
        contacts=contacts,
        solution=solution,
        springs=springs,
        motors=motors,
        regulator=_create_regulator(motion, robot),
        slip=FootSlip(touchdown=robot.initial_toes.copy(), distance=np.zeros(n)),
    )


def _create_body(motion: PlannedMotion) -> BodyState:
    """Create the body at rest in its first pose."""
    return BodyState(motion.com[0].copy(), motion.rotation[0].copy(), np.zeros(6), np.zeros(6))


def _create_regulator(motion: PlannedMotion, robot: RobotParameters) -> RegulatorState:
    """Create the state of the regulator, which knows where the robot is set up."""
    n, joints = motion.command.shape[1:]
    return RegulatorState(
        toes=robot.initial_toes.copy(),
        stood=motion.trusted[0].copy(),
        com=motion.com[0].copy(),
        rotation=motion.rotation[0].copy(),
        offset=robot.initial_toes - motion.initial_toes,
        accepted_offset=robot.initial_toes - motion.initial_toes,
        last_command=motion.command[0].copy(),
        command=motion.command[0].copy(),
        joint_error=np.zeros((n, joints)),
        toe_error=np.zeros((n, 3)),
        toe_body=np.zeros((n, 3)),
        mean_reading=np.zeros((n, joints)),
        single_reading=np.zeros((n, joints)),
        num_draws=np.zeros(1, np.int64),
        delayed_offset=np.zeros((n, 3)),
        history_time=np.zeros(_HISTORY_LENGTH),
        history_offset=np.zeros((_HISTORY_LENGTH if robot.delay > 0.0 else 0, n, 3)),
        num_recorded=np.zeros(1, np.int64),
    )
