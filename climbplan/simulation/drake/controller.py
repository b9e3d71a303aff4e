"""The documented controller of an exported plan.

    torque = P gain * (command - angle) + effort + gravity - D gain * velocity, within motor limits

Drake's own P and D control brings the first and the last term; this file has the others. Commands
are those of the file, or of the regulator that is exported beside it, which reads the encoders.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from climbplan.arrays import Array
from climbplan.control.joint_regulator import JointRegulator, read_tables
from climbplan.simulation.drake.exported import ExportedMotion

REGULATOR = "regulator/regulator.npz"  # in the directory of an export


class Controller(Protocol):
    """Whatever commands the joints."""

    def command(self, time: float, angles: Array) -> Array:
        """Return the commands (J,) [rad] at a time [s] for encoder angles (J,) [rad]."""


class FileController:
    """Commands as the file has them, straight from sample to sample."""

    def __init__(self, motion: ExportedMotion) -> None:
        self._motion = motion

    def command(self, time: float, angles: Array) -> Array:
        """Return the planned commands (J,), whatever the angles are."""
        return interpolate(self._motion.time, self._motion.command, time)


class RegulatedController:
    """Commands of the exported regulator, with its tables (N limbs, up to M joints each)."""

    def __init__(self, motion: ExportedMotion, path: Path) -> None:
        """Read the tables in a file `regulator.npz`."""
        self._regulator = JointRegulator(read_tables(path))
        with np.load(path, allow_pickle=False) as stored:
            names = [str(name) for name in stored["joint_names"].ravel()]
        self._shape = self._regulator.command.shape
        self._place = np.array([names.index(joint.name) for joint in motion.joints])
        self._angles = self._regulator.command.copy()

    def command(self, time: float, angles: Array) -> Array:
        """Return the corrected commands (J,)."""
        self._angles.flat[self._place] = angles
        return self._regulator.tick(time, self._angles).ravel()[self._place]


def interpolate(times: Array, values: Array, time: float) -> Array:
    """Return values (T, ...) at a time, on straight lines between samples at `times` (T,)."""
    after = int(np.clip(np.searchsorted(times, time, side="right"), 1, len(times) - 1))
    span = times[after] - times[after - 1]
    fraction = float(np.clip((time - times[after - 1]) / span, 0.0, 1.0))
    return np.asarray((1.0 - fraction) * values[after - 1] + fraction * values[after])
