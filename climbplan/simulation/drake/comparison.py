"""A recording compared with what was planned: the base's pose, torques and contact forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.simulation.drake.controller import interpolate
from climbplan.simulation.drake.exported import ExportedMotion
from climbplan.simulation.drake.playing import Recording

BEFORE, AFTER = 0.5, 0.1  # [s] about a change of contacts, in which forces are not compared
MIN_EFFORT = 0.02  # of motor limits or weight, below which a relative error says nothing


@dataclass(frozen=True)
class RecordingErrors:
    """Errors of a recording, S samples; relative ones NaN where contacts change."""

    distance: Array  # (S,) of the base from its plan [m]
    angle: Array  # (S,) [rad]
    torque_error: Array  # (S,) of the motor with the largest planned share of its limit
    all_torque_error: Array  # (S,) Euclidean norm over motors, in shares of their limits
    force_error: Array  # (S,) norm over toes, relative to the norm of the planned forces
    at_limit: float  # share of samples in which some motor brings its limit


def compare(recording: Recording, motion: ExportedMotion, weight: float) -> RecordingErrors:
    """Compare a recording with its plan.

    weight: of the robot [N].
    """
    times = np.array(recording.time)
    limit = np.array([joint.max_torque for joint in motion.joints])
    planned = np.array([interpolate(motion.time, motion.total_torque, t) for t in times]) / limit
    torque = np.array(recording.torque) / limit
    force = np.array([interpolate(motion.time, motion.force, t) for t in times])
    force_error = np.linalg.norm(np.array(recording.force) - force, axis=(1, 2))
    force_size = np.linalg.norm(force, axis=(1, 2))
    samples, worst = np.arange(len(times)), np.argmax(np.abs(planned), axis=1)
    is_settled = _mark_settled(motion, times)
    return RecordingErrors(
        distance=np.linalg.norm(recording.departure, axis=1),
        angle=np.array(recording.turned),
        torque_error=_compute_relative(
            np.abs(torque - planned)[samples, worst],
            np.abs(planned)[samples, worst],
            is_settled,
            MIN_EFFORT,
        ),
        all_torque_error=_compute_relative(
            np.linalg.norm(torque - planned, axis=1),
            np.linalg.norm(planned, axis=1),
            is_settled,
            MIN_EFFORT,
        ),
        force_error=_compute_relative(force_error, force_size, is_settled, MIN_EFFORT * weight),
        at_limit=float((np.abs(torque) > 1.0 - 1e-6).any(axis=1).mean()),
    )


def _compute_relative(error: Array, size: Array, is_settled: BoolArray, min_size: float) -> Array:
    out = np.full(len(error), np.nan)
    np.divide(error, size, out=out, where=is_settled & (size > min_size))
    return out


def _mark_settled(motion: ExportedMotion, times: Array) -> BoolArray:
    """Return (S,) whether no planned contact changes shortly before or after."""
    changed = (motion.touching[1:] != motion.touching[:-1]).any(axis=1)
    changes = motion.time[1:][changed]
    since = times[:, None] - changes
    return np.asarray(~((since > -AFTER) & (since < BEFORE)).any(axis=1))
