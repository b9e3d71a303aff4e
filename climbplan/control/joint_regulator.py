"""A regulator of a climbing robot's body and of the forces between its toes, from joint angles.

This file runs on a robot as it is: Python and NumPy, nothing of climbplan, no memory allocation
in a tick. `climbplan export PLAN --format regulator` writes it next to the tables that it reads:

    regulator = JointRegulator(read_tables("regulator.npz"))
    while time < regulator.end:
        commands = regulator.tick(time, encoder_angles)

`climbplan simulate` runs the same code. N limbs of J joints, T samples; world frame unless said.

State estimation: toes that carry load are assumed to stand still, spherical feet to roll on as the
plan turns them. Joint angles show the deflection of joints, and so how far the body has sunk
between its toes. The deflection of the structure is proportional to it and assumed to be known.
Backlash and slip of toes are not observed.

Control: each standing limb has an offset of its toe, which integrates two errors. For the pose,
toes are commanded as if the body had moved to its planned pose. This stops while a toe takes load
or is released, and its rate is limited so that a heavy body on soft joints does not oscillate. For
the forces, the measured deflection of joints is compared with the planned one, as a deflection d of
the toes. Only internal forces count: the projection d - B A^-1 B^T K d. In the air an offset decays
to zero.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import cos, isfinite, sin, sqrt
from os import PathLike

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE = 1.0  # [1/s] at which a pose error decays, where the body's springs allow it
FORCE_RATE = 3.0  # [1/s] at which errors of internal forces decay
DECAY_RATE = 3.0  # [1/s] of the offset of a limb in the air
MAX_OFFSET = 0.06  # [m] of a toe, within which offsets are linear
_MIN_TOES = 3  # standing toes that determine a pose
_MAX_STEPS = 20  # Gauss-Newton steps of an attitude; two or three suffice
_STEP_TOLERANCE = 1e-13  # [rad]


@dataclass(frozen=True)
class RegulatorTables:
    """A plan at each of its samples; truth values are 0.0 or 1.0."""

    time: Array  # (T,) [s], increasing
    command: Array  # (T, N, J) [rad]
    com: Array  # (T, 3) planned body [m]
    rotation: Array  # (T, 3, 3) body to world
    contact: Array  # (T, N) toes on their surfaces
    trusted: Array  # (T, N) of these the ones pressed firmly enough to estimate the body's pose
    settled: Array  # (T,) no toe takes load or is released
    jacobian: Array  # (T, N, 3, J) of toes [m/rad]
    turning: Array  # (T, N, J, 3) its damped inverse [rad/m]
    arms: Array  # (T, N, 3) from body to toes [m]
    internal_projector: Array  # (T, 3N, 3N) projector of toe deflections on internal forces
    deflection: Array  # (T, N, J) planned deflection of joints from their commands [rad]
    max_deflection: Array  # (N, J) largest deflection by motors [rad]
    compliance_ratio: Array  # (N, J) deflection of joint and structure per encoder radian
    rate: Array  # (T,) at which a pose error of the body decays [1/s]
    toes: Array  # (N, 3) toes at the start [m]
    rolled: Array  # (T, N, 3) by which standing toes have rolled since the start [m]
    axis_zero: Array  # (N, J, 3) axes at zero angles of revolute joints, body frame
    joint_zero: Array  # (N, J, 3) points on them [m]
    toe_zero: Array  # (N, 3) toes at zero angles [m]
    slide_zero: Array  # (N, J, 3) directions of prismatic joints, whose angles are lengths [m]
    drive: Array  # (N, J, J) motions of joints by angles: the identity but for mimic joints


_OLD_NAMES = {
    "internal_projector": "sharing",
    "deflection": "bent",
    "max_deflection": "most",
    "compliance_ratio": "give",
}


def read_tables(path: str | PathLike[str]) -> RegulatorTables:
    """Read the tables of a file; tables under their old names are read, too.

    Raises:
        KeyError: A table is missing.
    """
    with np.load(path, allow_pickle=False) as stored:
        arrays = {}
        for field in fields(RegulatorTables):
            old = _OLD_NAMES.get(field.name)
            name = old if old in stored and field.name not in stored else field.name
            arrays[field.name] = np.ascontiguousarray(stored[name], float)
    return RegulatorTables(**arrays)


class Chains:
    """Toes of limbs whose revolute or prismatic joints follow one another."""

    def __init__(
        self, axis_zero: Array, joint_zero: Array, toe_zero: Array, slide_zero: Array, drive: Array
    ) -> None:
        n, joints = axis_zero.shape[:2]
        self._slides = [
            np.ascontiguousarray(direction) if direction.any() else None
            for direction in slide_zero.swapaxes(0, 1)
        ]
        self._drive = None if (drive == np.eye(joints)).all() else np.ascontiguousarray(drive)
        self._joint_motions = np.empty((n, joints, 1))
        self._motions = self._joint_motions[..., 0]
        self._lengths = [self._motions[:, j : j + 1] for j in range(joints)]
        self._along = np.empty((n, 3))
        x, y, z = np.moveaxis(axis_zero, -1, 0)
        o = np.zeros_like(x)
        cross = np.array([[o, -z, y], [z, o, -x], [-y, x, o]]).transpose(3, 2, 0, 1)  # (J, N, 3, 3)
        # Rodrigues: v + K v sin + K K v (1 - cos)
        self._turns = np.ascontiguousarray(np.concatenate([cross, cross @ cross], axis=2))
        self._joints = np.ascontiguousarray(joint_zero.swapaxes(0, 1))
        self._toes = toe_zero.copy()
        self.toes = toe_zero.copy()
        self._sin, self._versed = np.empty((n, joints)), np.empty((n, joints))
        self._sines = [self._sin[:, j : j + 1] for j in range(joints)]
        self._verseds = [self._versed[:, j : j + 1] for j in range(joints)]
        self._arm = np.empty((n, 3, 1))
        self._arms = self._arm[..., 0]
        self._rotated_arms = np.empty((n, 6, 1))
        self._once, self._twice = self._rotated_arms[:, :3, 0], self._rotated_arms[:, 3:, 0]

    def place(self, angles: Array) -> Array:
        """Return toes (N, 3) in the body frame at angles (N, J) [m].

        The result is overwritten by the next call.
        """
        if self._drive is None:
            np.copyto(self._motions, angles)
        else:
            np.matmul(self._drive, angles[..., None], out=self._joint_motions)
        np.sin(self._motions, out=self._sin)
        np.cos(self._motions, out=self._versed)
        np.subtract(1.0, self._versed, out=self._versed)
        toes = self.toes
        toes[:] = self._toes
        for j in range(len(self._joints) - 1, -1, -1):
            np.subtract(toes, self._joints[j], out=self._arms)
            np.matmul(self._turns[j], self._arm, out=self._rotated_arms)
            np.multiply(self._once, self._sines[j], out=self._once)
            np.multiply(self._twice, self._verseds[j], out=self._twice)
            np.add(toes, self._once, out=toes)
            np.add(toes, self._twice, out=toes)
            direction = self._slides[j]
            if direction is not None:
                np.multiply(direction, self._lengths[j], out=self._along)
                np.add(toes, self._along, out=toes)
        return toes


def build_chains(tables: RegulatorTables) -> Chains:
    """Return the limbs of the tables."""
    return Chains(
        tables.axis_zero, tables.joint_zero, tables.toe_zero, tables.slide_zero, tables.drive
    )


class BodyPoseEstimate:
    """Estimate of the body's pose, from toes that are assumed to stand still."""

    def __init__(self, tables: RegulatorTables, toes: Array | None = None) -> None:
        """Start from the first sample of a plan.

        toes: (N, 3) at the start, as far as is known [m]; None: as planned.
        """
        n = len(tables.toes)
        self._trusted = tables.trusted
        self._rolls = tables.rolled if tables.rolled.any() else None
        self._rolled = tables.rolled[0].copy()
        self._stood_before = tables.trusted[0].copy()
        self._places = (tables.toes if toes is None else toes).copy()
        self.com, self.rotation = tables.com[0].copy(), tables.rotation[0].copy()
        self.errors = np.zeros(n)  # [m] by which standing toes are off their places
        self._is_standing, self._column = np.empty(n), np.empty((n, 1))
        self._middle, self._target_mean = np.empty(3), np.empty(3)
        self._local, self._target, self._rotated = (np.empty((n, 3)) for _ in range(3))
        self._across, self._spread, self._turn, self._next = (np.empty((3, 3)) for _ in range(4))

    def update(self, sample: int, toes: Array, trusted: Array | None = None) -> None:
        """Set `com` and `rotation` by toes (N, 3) in the body frame at a sample of the plan.

        trusted: (N,) toes that stand, as far as is measured; None: as planned.
        """
        is_standing = self._is_standing
        if trusted is None:
            trusted = self._trusted[sample]
        if self._rolls is not None:
            rolled = self._rolls[sample]
            np.subtract(rolled, self._rolled, out=self._rotated)
            np.add(self._places, self._rotated, out=self._places)
            np.copyto(self._rolled, rolled)
        np.multiply(trusted, self._stood_before, out=is_standing)
        count = float(np.add.reduce(is_standing))
        if count >= _MIN_TOES:
            self._fit(toes, count)
        np.dot(toes, self.rotation.T, out=self._rotated)
        np.add(self._rotated, self.com, out=self._rotated)
        np.subtract(
            trusted, is_standing, out=is_standing
        )  # those that stand from now on, where they are
        np.copyto(self._column[:, 0], is_standing)
        np.subtract(self._rotated, self._places, out=self._rotated)
        np.multiply(self._rotated, self._rotated, out=self._local)
        np.add.reduce(self._local, axis=1, out=self.errors)
        np.sqrt(self.errors, out=self.errors)
        np.multiply(self.errors, self._stood_before, out=self.errors)
        np.multiply(self.errors, trusted, out=self.errors)
        np.multiply(self._rotated, self._column, out=self._rotated)
        np.add(self._places, self._rotated, out=self._places)
        self._stood_before[:] = trusted

    @property
    def places(self) -> Array:
        """Places (N, 3) of toes that stand, or stood last [m]; not a copy."""
        return self._places

    def forget(self, limb: int) -> None:
        """Take the place of a toe anew: it has moved."""
        self._stood_before[limb] = 0.0

    def _fit(self, toes: Array, count: float) -> None:
        """Fit the translation and rotation that carry standing toes nearest to their positions."""
        is_standing, middle, target_mean = self._is_standing, self._middle, self._target_mean
        np.copyto(self._column[:, 0], is_standing)
        for points, mean, centred in (
            (toes, middle, self._local),
            (self._places, target_mean, self._target),
        ):
            np.dot(is_standing, points, out=mean)
            np.divide(mean, count, out=mean)
            np.subtract(points, mean, out=centred)
            np.multiply(centred, self._column, out=centred)
        rotated = self._rotated
        for _ in range(_MAX_STEPS):
            np.dot(self._local, self.rotation.T, out=rotated)
            if self._step_rotation(rotated) < _STEP_TOLERANCE:
                break
        np.dot(self.rotation, middle, out=self.com)
        np.subtract(target_mean, self.com, out=self.com)

    def _step_rotation(self, rotated: Array) -> float:
        """Rotate the body by one Gauss-Newton step; return its angle [rad]."""
        np.dot(rotated.T, self._target, out=self._across)
        np.dot(rotated.T, rotated, out=self._spread)
        (_, h01, h02), (h10, _, h12), (h20, h21, _) = self._across.tolist()
        (a, b, c), (_, d, e), (_, _, f) = self._spread.tolist()
        # (tr S - S) turn = sum of rotated x target; regularised for toes in a line
        size = a + d + f
        a, d, f = size - a + 1e-9, size - d + 1e-9, size - f + 1e-9
        b, c, e = -b, -c, -e
        x, y, z = h12 - h21, h20 - h02, h01 - h10
        p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
        volume = a * p + b * q + c * r
        s, t, u = a * f - c * c, b * c - a * e, a * d - b * b
        x, y, z = (
            (p * x + q * y + r * z) / volume,
            (q * x + s * y + t * z) / volume,
            (r * x + t * y + u * z) / volume,
        )
        angle = sqrt(x * x + y * y + z * z)
        if angle > 0.0:
            _compute_rotation(x / angle, y / angle, z / angle, angle, self._turn)
            np.dot(self._turn, self.rotation, out=self._next)
            self.rotation[:] = self._next
        return angle


class Corrections:
    """Integral action on the body's attitude and on forces, and on its position if required."""

    def __init__(self, tables: RegulatorTables, place: bool = True) -> None:
        n, joints = tables.max_deflection.shape
        self.tables, self._place = tables, place
        self._last = len(tables.com) - 1
        self._min_deflection = -tables.max_deflection
        self._settled = [value > 0.5 for value in tables.settled.tolist()]
        # Of the toes [m]; at the start, how far they stand off their planned places
        self.offset = np.zeros((n, 3))
        self.added = np.zeros((n, joints))  # to joint commands [rad]
        self._planned, self._missing = np.empty((n, joints)), np.empty((n, joints, 1))
        self._lag = self._missing[..., 0]
        self._deflected, self._column = np.empty((n, 3, 1)), np.empty((n, 3, 1))
        self._flat = self._deflected.reshape(-1)
        self._shared = np.empty(3 * n)
        self._offset_rate = self._shared.reshape(n, 3)
        self._wide, self._target_offset = np.empty((n, 3)), np.empty((n, 3))
        self._length, self._stands = np.empty((n, 1)), np.empty((n, 1))
        self._com, self._step = np.empty(3), np.empty(3)
        self._reference_rotation, self._change, self._skew = (np.empty((3, 3)) for _ in range(3))
        self._add = self.added[..., None]

    def update(
        self,
        sample: float,
        seconds: float,
        com: Array,
        rotation: Array,
        lag: Array,
        added_deflection: Array | None = None,
    ) -> Array:
        """Return what to add to the joint commands (N, J) [rad], overwritten by the next call.

        Args:
            sample: Of the plan, between two of its samples.
            seconds: Since the last call [s].
            com: Position of the body (3,) [m].
            rotation: Rotation of the body (3, 3).
            lag: Joint angles (N, J) minus the last commands, less what carries links [rad].
            added_deflection: What joints (N, J) are to deflect beyond the plan, by forces that
                replace the planned ones [rad]; None for nothing.
        """
        tables = self.tables
        index = min(int(sample), self._last)
        after, fraction = min(index + 1, self._last), sample - int(sample)
        _interpolate(tables.deflection[index], tables.deflection[after], fraction, self._planned)
        if added_deflection is not None:
            np.add(self._planned, added_deflection, out=self._planned)
        np.maximum(lag, self._min_deflection, out=self._lag)
        np.minimum(self._lag, tables.max_deflection, out=self._lag)
        np.subtract(self._planned, self._lag, out=self._lag)
        np.matmul(tables.jacobian[index], self._missing, out=self._deflected)
        np.dot(tables.internal_projector[index], self._flat, out=self._shared)
        rate = self._offset_rate
        np.multiply(rate, -FORCE_RATE, out=rate)
        if self._settled[index]:
            self._correct_pose(index, after, fraction, com, rotation)
        target = self._target_offset
        np.multiply(rate, seconds, out=target)
        np.add(target, self.offset, out=target)
        np.multiply(target, target, out=self._wide)
        np.add.reduce(self._wide, axis=1, out=self._length, keepdims=True)
        np.sqrt(self._length, out=self._length)
        np.maximum(self._length, MAX_OFFSET, out=self._length)
        np.divide(MAX_OFFSET, self._length, out=self._length)
        np.multiply(target, self._length, out=target)
        # In the air back to zero
        np.copyto(self._stands[:, 0], tables.contact[index])
        np.multiply(self.offset, max(0.0, 1.0 - DECAY_RATE * seconds), out=self.offset)
        np.subtract(target, self.offset, out=target)
        np.multiply(target, self._stands, out=target)
        np.add(self.offset, target, out=self.offset)
        return self.compute_joint_offsets(index)

    def compute_joint_offsets(self, sample: int) -> Array:
        """Return what offsets add to the joint commands (N, J) at a sample of the plan [rad]."""
        np.copyto(self._column[..., 0], self.offset)
        np.matmul(self.tables.turning[sample], self._column, out=self._add)
        return self.added

    def _correct_pose(
        self, index: int, after: int, fraction: float, com: Array, rotation: Array
    ) -> None:
        """Subtract the pose error from the rate of the offsets.

        A body that is to move by (shift, turn) sees its toes move the other way.
        """
        tables, wide = self.tables, self._wide
        _interpolate(
            tables.rotation[index], tables.rotation[after], fraction, self._reference_rotation
        )
        np.dot(self._reference_rotation, rotation.T, out=self._change)
        (_, o01, o02), (o10, _, o12), (o20, o21, _) = self._change.tolist()
        x, y, z = (o21 - o12) / 2, (o02 - o20) / 2, (o10 - o01) / 2
        _fill(self._skew, (0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
        np.dot(tables.arms[index], self._skew.T, out=wide)
        if self._place:
            _interpolate(tables.com[index], tables.com[after], fraction, self._com)
            np.subtract(self._com, com, out=self._step)
            np.add(wide, self._step, out=wide)
        np.multiply(wide, tables.rate[index], out=wide)
        np.subtract(self._offset_rate, wide, out=self._offset_rate)


class JointRegulator:
    """Commands at any time of a plan, corrected by the readings of joint encoders."""

    def __init__(
        self, tables: RegulatorTables, place: bool = True, toes: Array | None = None
    ) -> None:
        """Start at the beginning of a plan.

        toes: (N, 3) at the start, as far as is known [m]; None: as planned.
        """
        self._tables = tables
        self._times = tables.time.tolist()
        self._index, self._now = 0, self._times[0]
        self._chains = build_chains(tables)
        self.pose = BodyPoseEstimate(tables, toes)
        self.corrections = Corrections(tables, place)
        if toes is not None:
            self.corrections.offset[:] = toes - tables.toes
        self.command = tables.command[0] + self.corrections.compute_joint_offsets(0)
        self._lag, self._angles = np.empty_like(self.command), np.empty_like(self.command)

    @property
    def end(self) -> float:
        """The end of the plan [s]."""
        return float(self._times[-1])

    def tick(self, time: float, angles: Array) -> Array:
        """Return commands (N, J) for now [rad], overwritten by the next tick.

        Args:
            time: Of the plan [s], never less than at the tick before. After its end the last
                commands
                are kept and corrected.
            angles: Encoder readings (N, J) [rad].

        Raises:
            ValueError: Time goes back, or an angle is no number.
        """
        seconds, times, tables = time - self._now, self._times, self._tables
        if not seconds >= 0.0:
            raise ValueError(f"time goes back: {time!r} after {self._now!r}")
        index, last = self._index, len(times) - 1
        while index < last and times[index + 1] <= time:
            index += 1
        fraction = (
            (time - times[index]) / (times[index + 1] - times[index]) if index < last else 0.0
        )
        np.subtract(angles, self.command, out=self._lag)
        np.multiply(self._lag, tables.compliance_ratio, out=self._lag)
        np.add(self.command, self._lag, out=self._angles)
        if not isfinite(float(np.add.reduce(self._angles, axis=None))):
            raise ValueError("an angle is no number")
        self._index, self._now = index, time
        self.pose.update(index + 1 if fraction > 0.0 else index, self._chains.place(self._angles))
        correction = self.corrections.update(
            index + fraction, seconds, self.pose.com, self.pose.rotation, self._lag
        )
        _interpolate(
            tables.command[index], tables.command[min(index + 1, last)], fraction, self.command
        )
        np.add(self.command, correction, out=self.command)
        return self.command


def _interpolate(before: Array, after: Array, fraction: float, out: Array) -> None:
    """Interpolate linearly between two arrays, into `out`."""
    np.subtract(after, before, out=out)
    np.multiply(out, fraction, out=out)
    np.add(out, before, out=out)


_Row = tuple[float, float, float]


def _fill(out: Array, first_row: _Row, second_row: _Row, third_row: _Row) -> None:
    """Fill a 3 x 3 matrix with the values of its rows, which NumPy need not convert."""
    out[0, 0], out[0, 1], out[0, 2] = first_row
    out[1, 0], out[1, 1], out[1, 2] = second_row
    out[2, 0], out[2, 1], out[2, 2] = third_row


def _compute_rotation(x: float, y: float, z: float, angle: float, out: Array) -> None:
    """Compute the rotation about a unit vector by an angle [rad], into `out`."""
    c, s = cos(angle), sin(angle)
    k = 1.0 - c
    _fill(
        out,
        (c + k * x * x, k * x * y - s * z, k * x * z + s * y),
        (k * x * y + s * z, c + k * y * y, k * y * z - s * x),
        (k * x * z - s * y, k * y * z + s * x, c + k * z * z),
    )
