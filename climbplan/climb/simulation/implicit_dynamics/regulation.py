"""The regulator of body pose and contact forces with its odometry, as compiled functions.

They follow `climbplan/control/joint_regulator.py`, with the longer time steps of this simulator.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import _compute_kinematics
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import (
    _add_matrix_product,
    _apply_matrix,
    _apply_wide_matrix,
    _cross,
    _invert,
    _rotate,
)
from climbplan.climb.simulation.implicit_dynamics.state import (
    PlannedMotion,
    RegulatorState,
    ScratchMemory,
    TimeStep,
)
from climbplan.control.joint_regulator import DECAY_RATE, FORCE_RATE, MAX_OFFSET, RATE

CONTROL_PERIOD = 0.01  # [s] between readings of the regulator, as `replay.py` has it
_MIN_STANDING_TOES = 3  # of an estimate of the pose
_MAX_ITERATIONS = 4  # Gauss-Newton steps of the rotation, from the last pose
_ROTATION_TOLERANCE = 1e-6  # [rad] of the last step: the next would be a millionth of it


@compiled
def _read_sensors(rotor: Array, noise: Array, span: float, regulator: RegulatorState) -> None:
    """Simulate sensor readings of joint angles (N, J) over a step of span [s].

    The regulator integrates one reading every CONTROL_PERIOD, so the noise of their mean is
    smaller. Odometry locates a toe that touches down by a single reading.
    """
    single, mean = regulator.single_reading, regulator.mean_reading
    noise_scale = np.sqrt(CONTROL_PERIOD / span)
    for i in range(len(rotor)):
        for j in range(rotor.shape[1]):
            single[i, j] = mean[i, j] = rotor[i, j]
            if len(noise):
                mean[i, j] += noise_scale * noise[regulator.num_draws[0] % len(noise), i, j]
                single[i, j] += noise[(regulator.num_draws[0] + 1) % len(noise), i, j]
    regulator.num_draws[0] += 2


@compiled
def _record_offsets(time: float, regulator: RegulatorState) -> None:
    """Append the corrections at a time [s] to the ring buffer."""
    k = regulator.num_recorded[0] % len(regulator.history_time)
    regulator.history_time[k] = time
    for i in range(len(regulator.offset)):
        for a in range(3):
            regulator.history_offset[k, i, a] = regulator.offset[i, a]
    regulator.num_recorded[0] += 1


@compiled
def _compute_delayed_offsets(time: float, now: float, regulator: RegulatorState) -> None:
    """Interpolate the corrections at an earlier time [s], into `regulator.delayed_offset`.

    now: the time of the present corrections `regulator.offset` [s].
    """
    later_time, later_offset = now, regulator.offset
    for back in range(1, min(regulator.num_recorded[0], len(regulator.history_time)) + 1):
        k = (regulator.num_recorded[0] - back) % len(regulator.history_time)
        if regulator.history_time[k] <= time:
            fraction = (time - regulator.history_time[k]) / max(
                later_time - regulator.history_time[k], 1e-12
            )
            for i in range(len(later_offset)):
                for a in range(3):
                    earlier = regulator.history_offset[k, i, a]
                    regulator.delayed_offset[i, a] = earlier + fraction * (
                        later_offset[i, a] - earlier
                    )
            return
        later_time, later_offset = regulator.history_time[k], regulator.history_offset[k]
    for i in range(len(later_offset)):
        for a in range(3):
            regulator.delayed_offset[i, a] = later_offset[i, a]


@compiled
def _estimate_pose(
    motion: PlannedMotion,
    s: int,
    regulator: RegulatorState,
    work: ScratchMemory,
) -> None:
    """Estimate the pose of the body from joint readings, with standing toes as landmarks."""
    angles, toes, stood = (
        regulator.mean_reading, regulator.toes, regulator.stood,
    )  # fmt: skip
    com, rotation = regulator.com, regulator.rotation
    toe_body = regulator.toe_body
    count = 0
    for i in range(len(angles)):
        _compute_kinematics(
            motion.zero_pose[i], angles[i], work.jacobian, work.joint_axes, toe_body[i]
        )
        count += 1 if motion.trusted[s, i] and stood[i] else 0
    if count >= _MIN_STANDING_TOES:
        _fit_rigid_motion(motion.trusted[s], stood, toe_body, toes, com, rotation, work)
    for i in range(len(angles)):
        if motion.trusted[s, i] and not stood[i]:
            _compute_kinematics(
                motion.zero_pose[i],
                regulator.single_reading[i],
                work.jacobian,
                work.joint_axes,
                work.vectors[rows.TOE],
            )
            _apply_matrix(rotation, work.vectors[rows.TOE], work.vectors[rows.TOE_OFFSET])
            for a in range(3):
                toes[i, a] = com[a] + work.vectors[rows.TOE_OFFSET][a]
        stood[i] = motion.trusted[s, i]


@compiled
def _fit_rigid_motion(
    trusted: Array,
    stood: Array,
    toe_body: Array,
    toes: Array,
    com: Array,
    rotation: Array,
    work: ScratchMemory,
) -> None:
    """Fit com and rotation that map toe_body (N, 3) to toes (N, 3), in the least-squares sense.

    The rotation starts at its last value and is refined by Gauss-Newton steps.
    """
    body_centroid = work.vectors[rows.BODY_CENTROID]
    world_centroid = work.vectors[rows.WORLD_CENTROID]
    rotated_arm, world_arm = work.vectors[rows.ROTATED_ARM], work.vectors[rows.WORLD_ARM]
    arm_product, gradient = work.vectors[rows.ARM_PRODUCT], work.vectors[rows.GRADIENT]
    rotation_step = work.vectors[rows.ROTATION_STEP]
    normal, inverse = work.matrices[rows.NORMAL_MATRIX], work.matrices[rows.INVERSE]
    _compute_centroid(trusted, stood, toe_body, body_centroid)
    _compute_centroid(trusted, stood, toes, world_centroid)
    for _ in range(_MAX_ITERATIONS):
        normal[:] = 0.0
        gradient[:] = 0.0
        for i in range(len(toe_body)):
            if not (trusted[i] and stood[i]):
                continue
            for a in range(3):
                world_arm[a] = toe_body[i, a] - body_centroid[a]
            _apply_matrix(rotation, world_arm, rotated_arm)
            for a in range(3):
                world_arm[a] = toes[i, a] - world_centroid[a]
            _cross(rotated_arm, world_arm, arm_product)
            squared_norm = rotated_arm[0] ** 2 + rotated_arm[1] ** 2 + rotated_arm[2] ** 2
            for a in range(3):
                gradient[a] += arm_product[a]
                for b in range(3):
                    normal[a, b] -= rotated_arm[a] * rotated_arm[b]
                normal[a, a] += squared_norm
        for a in range(3):
            normal[a, a] += 1e-9  # toes in a line: least rotation about the line
        _invert(normal, inverse)
        _apply_matrix(inverse, gradient, rotation_step)
        _rotate(rotation, rotation_step)
        if (
            rotation_step[0] ** 2 + rotation_step[1] ** 2 + rotation_step[2] ** 2
            < _ROTATION_TOLERANCE**2
        ):
            break
    _apply_matrix(rotation, body_centroid, rotated_arm)
    for a in range(3):
        com[a] = world_centroid[a] - rotated_arm[a]


@compiled
def _compute_centroid(trusted: Array, stood: Array, points: Array, centroid: Array) -> None:
    """Compute the centroid (3,) of the points (N, 3) of toes that are trusted and stood before."""
    centroid[:] = 0.0
    count = 0
    for i in range(len(points)):
        if trusted[i] and stood[i]:
            count += 1
            for a in range(3):
                centroid[a] += points[i, a]
    for a in range(3):
        centroid[a] /= count


@compiled
def _update_offsets(
    motion: PlannedMotion,
    step: TimeStep,
    correct_position: bool,
    com: Array,
    rotation: Array,
    regulator: RegulatorState,
    work: ScratchMemory,
) -> None:
    """Integrate errors of body pose and contact forces over a time step into toe corrections.

    com, rotation: pose at the start of the step. correct_position: whether position errors count in
    addition to rotation. regulator.joint_error is an input.
    """
    s, previous, fraction, span = (
        step.planned_step,
        max(step.planned_step - 1, 0),
        step.elapsed,
        step.span,
    )
    joint_error, toe_error, offset = regulator.joint_error, regulator.toe_error, regulator.offset
    position_error = work.vectors[rows.POSITION_ERROR]
    rotation_error = work.vectors[rows.ROTATION_ERROR]
    rotation_shift = work.vectors[rows.ROTATION_SHIFT]
    deflection_error = work.joint_vectors[rows.DEFLECTION_ERROR]
    desired_rotation = work.matrices[rows.DESIRED_ROTATION]
    _compute_rotation_error(motion, step, rotation, desired_rotation, rotation_error)
    for a in range(3):
        desired = (1 - fraction) * motion.com[previous, a] + fraction * motion.com[s, a]
        position_error[a] = desired - com[a] if correct_position else 0.0
    n = len(joint_error)
    for i in range(n):
        for j in range(joint_error.shape[1]):
            limit = motion.max_deflection[i, j]
            desired = (1 - fraction) * motion.joint_deflection[
                previous, i, j
            ] + fraction * motion.joint_deflection[s, i, j]
            deflection_error[j] = desired - min(max(joint_error[i, j], -limit), limit)
        _apply_wide_matrix(motion.jacobian[previous, i], deflection_error, toe_error[i])
    for i in range(n):
        if not motion.contact[previous, i]:
            for a in range(3):
                offset[i, a] *= max(0.0, 1.0 - DECAY_RATE * span)
            continue
        for a in range(3):
            total = 0.0
            for k in range(n):
                for b in range(3):
                    total += (
                        motion.internal_projector[previous, 3 * i + a, 3 * k + b] * toe_error[k, b]
                    )
            offset[i, a] -= FORCE_RATE * span * total
        if motion.allow_pose_correction[previous]:
            _cross(rotation_error, motion.moment_arm[previous, i], rotation_shift)
            for a in range(3):
                offset[i, a] -= RATE * span * (position_error[a] + rotation_shift[a])
        _limit_norm(offset[i], MAX_OFFSET)


@compiled
def _compute_rotation_error(
    motion: PlannedMotion, step: TimeStep, rotation: Array, desired_rotation: Array, out: Array
) -> None:
    """Compute the rotation vector (3,) from a rotation to the planned one, to first order.

    The planned rotation at the start of the step is left in desired_rotation (3, 3).
    """
    s, previous, fraction = step.planned_step, max(step.planned_step - 1, 0), step.elapsed
    for a in range(3):
        for b in range(3):
            desired_rotation[a, b] = (1 - fraction) * motion.rotation[
                previous, a, b
            ] + fraction * motion.rotation[s, a, b]
    # The skew-symmetric part of desired_rotation @ rotation.T
    for a in range(3):
        i, j = (a + 2) % 3, (a + 1) % 3
        out[a] = 0.0
        for b in range(3):
            out[a] += (
                desired_rotation[i, b] * rotation[j, b] - desired_rotation[j, b] * rotation[i, b]
            ) / 2


@compiled
def _add_offset_commands(motion: PlannedMotion, s: int, offset: Array, command: Array) -> None:
    """Add the joint motion that moves toes by offsets (N, 3) to commands (N, J)."""
    for i in range(len(command)):
        _add_matrix_product(motion.jacobian_inverse[s, i], offset[i], command[i])


@compiled
def _limit_norm(vector: Array, max_norm: float) -> None:
    """Scale a vector (3,) down to a norm of at most max_norm, in place."""
    length = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if length > max_norm:
        for a in range(3):
            vector[a] *= max_norm / length


@compiled
def _add_foothold_errors(
    motion: PlannedMotion, s: int, foothold_error: Array, command: Array, work: ScratchMemory
) -> None:
    """Add the joint motion of foothold errors (N, P, 3) to commands (N, J)."""
    toe_offset = work.vectors[rows.TOE_OFFSET]
    for i in range(len(command)):
        index, phase = motion.foothold[s, i], motion.swing_phase[s, i]
        following = min(index + 1, foothold_error.shape[1] - 1)
        for a in range(3):
            toe_offset[a] = (1 - phase) * foothold_error[i, index, a] + phase * foothold_error[
                i, following, a
            ]
        if toe_offset[0] != 0.0 or toe_offset[1] != 0.0 or toe_offset[2] != 0.0:
            _add_matrix_product(motion.jacobian_inverse[s, i], toe_offset, command[i])
