"""A regulator of a climbing robot's body and of the forces between its toes, from joint angles.

This file runs on a robot as it is: Python and NumPy, nothing of climbplan, no memory taken while it
ticks. `climbplan export PLAN --format regulator` writes it beside the tables that it reads:

    regulator = JointRegulator(read_tables("regulator.npz"))
    while time < regulator.end:
        commands = regulator.tick(time, encoder_angles)

`climbplan simulate` runs the same code. N limbs of J joints, T samples; world frame unless said.

Where the body is: toes that carry load are believed to stand where they stood, spherical feet to
roll on as the plan turns them. Angles tell how far
motors give way, and so how far the body has sunk between its toes; what the structure gives beside
goes with it and is taken as known. What joints play and how far toes slide is not seen.

What is told: each standing limb has an offset of its toe, which integrates two errors. Of the pose:
toes are commanded as if the body had moved to where it should be, but for spans in which a toe
takes load or is let go of, and no faster than a heavy body on soft joints bears without swinging.
Of the forces: how far joints lag behind what they are told, beside how far they should, as a
deflection d of the toes; only what toes press against each other counts, d - B A^-1 B^T K d. In the
air an offset goes back to zero.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import cos, isfinite, sin, sqrt
from os import PathLike

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE = 1.0  # [1/s] at which a departure is worked off, where the body's springs allow it
FORCE_RATE = 3.0  # [1/s] at which forces between toes are
BACK = 3.0  # [1/s] at which the offset of a limb in the air goes back to zero
MOST_OFFSET = 0.06  # [m] of a toe, within which offsets are linear
_FEWEST = 3  # standing toes that tell a pose
_FITS = 20  # Gauss-Newton steps of an attitude at most; two or three do
_FITTED = 1e-13  # [rad] of a step after which it stands


@dataclass(frozen=True)
class RegulatorTables:
    """What a plan says at each of its samples; truths are 0.0 or 1.0."""

    time: Array  # (T,) [s], increasing
    command: Array  # (T, N, J) [rad]
    com: Array  # (T, 3) planned body [m]
    rotation: Array  # (T, 3, 3) body to world
    contact: Array  # (T, N) toes on their surfaces
    trusted: Array  # (T, N) of these the ones pressed firmly enough to tell where the body is
    settled: Array  # (T,) no toe takes load or is let go of
    jacobian: Array  # (T, N, 3, J) of toes [m/rad]
    turning: Array  # (T, N, J, 3) its inverse [rad/m]
    arms: Array  # (T, N, 3) from body to toes [m]
    sharing: Array  # (T, 3N, 3N) of toe deflections the part that no motion of the body explains
    bent: Array  # (T, N, J) how far joints should be from what they are told [rad]
    most: Array  # (N, J) that motors can bend them [rad]
    give: Array  # (N, J) that joints and structure give for each radian that encoders see
    rate: Array  # (T,) at which a departure of the body is worked off [1/s]
    toes: Array  # (N, 3) where toes stand at the start [m]
    rolled: Array  # (T, N, 3) how far toes that stand have rolled on since the start [m]
    axis_zero: Array  # (N, J, 3) axes at zero angles of joints that turn, body frame
    joint_zero: Array  # (N, J, 3) points on them [m]
    toe_zero: Array  # (N, 3) toes at zero angles [m]
    slide_zero: Array  # (N, J, 3) directions of joints that slide, whose angles are lengths [m]
    drive: Array  # (N, J, J) how far joints move by angles: the identity but of mimic joints


def read_tables(path: str | PathLike[str]) -> RegulatorTables:
    """The tables of a file; raises KeyError where one is missing."""
    with np.load(path, allow_pickle=False) as stored:
        return RegulatorTables(
            **{f.name: np.ascontiguousarray(stored[f.name], float) for f in fields(RegulatorTables)}
        )


class Chains:
    """Toes of limbs whose joints turn or slide one after the other."""

    def __init__(
        self, axis_zero: Array, joint_zero: Array, toe_zero: Array, slide_zero: Array, drive: Array
    ) -> None:
        n, joints = axis_zero.shape[:2]
        self._slides = [
            np.ascontiguousarray(way) if way.any() else None for way in slide_zero.swapaxes(0, 1)
        ]
        self._drive = None if (drive == np.eye(joints)).all() else np.ascontiguousarray(drive)
        self._moved = np.empty((n, joints, 1))
        self._motions = self._moved[..., 0]
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
        self._turned = np.empty((n, 6, 1))
        self._once, self._twice = self._turned[:, :3, 0], self._turned[:, 3:, 0]

    def place(self, angles: Array) -> Array:
        """(N, 3) toes in the body frame at angles (N, J) [m]; overwritten by the next call."""
        if self._drive is None:
            np.copyto(self._motions, angles)
        else:
            np.matmul(self._drive, angles[..., None], out=self._moved)
        np.sin(self._motions, out=self._sin)
        np.cos(self._motions, out=self._versed)
        np.subtract(1.0, self._versed, out=self._versed)
        toes = self.toes
        toes[:] = self._toes
        for j in range(len(self._joints) - 1, -1, -1):
            np.subtract(toes, self._joints[j], out=self._arms)
            np.matmul(self._turns[j], self._arm, out=self._turned)
            np.multiply(self._once, self._sines[j], out=self._once)
            np.multiply(self._twice, self._verseds[j], out=self._twice)
            np.add(toes, self._once, out=toes)
            np.add(toes, self._twice, out=toes)
            way = self._slides[j]
            if way is not None:
                np.multiply(way, self._lengths[j], out=self._along)
                np.add(toes, self._along, out=toes)
        return toes


def chains_of(tables: RegulatorTables) -> Chains:
    """The limbs that tables tell of."""
    return Chains(
        tables.axis_zero, tables.joint_zero, tables.toe_zero, tables.slide_zero, tables.drive
    )


class Pose:
    """Where the body is, by toes believed to stand where they stood."""

    def __init__(self, tables: RegulatorTables, toes: Array | None = None) -> None:
        """toes: (N, 3) where they stand at the start, as far as is known; as planned."""
        n = len(tables.toes)
        self._trusted = tables.trusted
        self._rolls = tables.rolled if tables.rolled.any() else None
        self._rolled = tables.rolled[0].copy()
        self._stood = tables.trusted[0].copy()
        self._places = (tables.toes if toes is None else toes).copy()
        self.com, self.rotation = tables.com[0].copy(), tables.rotation[0].copy()
        self._known, self._column = np.empty(n), np.empty((n, 1))
        self._middle, self._there = np.empty(3), np.empty(3)
        self._local, self._away, self._own = (np.empty((n, 3)) for _ in range(3))
        self._across, self._spread, self._turn, self._next = (np.empty((3, 3)) for _ in range(4))

    def update(self, sample: int, toes: Array) -> None:
        """Set `com` and `rotation` by toes (N, 3) in the body frame at a sample of the plan."""
        known, trusted = self._known, self._trusted[sample]
        if self._rolls is not None:
            rolled = self._rolls[sample]
            np.subtract(rolled, self._rolled, out=self._own)
            np.add(self._places, self._own, out=self._places)
            np.copyto(self._rolled, rolled)
        np.multiply(trusted, self._stood, out=known)
        count = float(np.add.reduce(known))
        if count >= _FEWEST:
            self._fit(toes, count)
        np.dot(toes, self.rotation.T, out=self._own)
        np.add(self._own, self.com, out=self._own)
        np.subtract(trusted, known, out=known)  # those that stand from now on, where they are
        np.copyto(self._column[:, 0], known)
        np.subtract(self._own, self._places, out=self._own)
        np.multiply(self._own, self._column, out=self._own)
        np.add(self._places, self._own, out=self._places)
        self._stood[:] = trusted

    def _fit(self, toes: Array, count: float) -> None:
        """Translation and rotation that carry known toes nearest to their places."""
        known, middle, there = self._known, self._middle, self._there
        np.copyto(self._column[:, 0], known)
        for points, mean, apart in (
            (toes, middle, self._local),
            (self._places, there, self._away),
        ):
            np.dot(known, points, out=mean)
            np.divide(mean, count, out=mean)
            np.subtract(points, mean, out=apart)
            np.multiply(apart, self._column, out=apart)
        own = self._own
        for _ in range(_FITS):
            np.dot(self._local, self.rotation.T, out=own)
            if self._turned(own) < _FITTED:
                break
        np.dot(self.rotation, middle, out=self.com)
        np.subtract(there, self.com, out=self.com)

    def _turned(self, own: Array) -> float:
        """Turn the body by one step of Gauss and Newton; how far [rad]."""
        np.dot(own.T, self._away, out=self._across)
        np.dot(own.T, own, out=self._spread)
        (_, h01, h02), (h10, _, h12), (h20, h21, _) = self._across.tolist()
        (a, b, c), (_, d, e), (_, _, f) = self._spread.tolist()
        # (tr S - S) turn = sum of own x away; toes in a line leave the turn about it: the least
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
            _turn_matrix(x / angle, y / angle, z / angle, angle, self._turn)
            np.dot(self._turn, self.rotation, out=self._next)
            self.rotation[:] = self._next
        return angle


class Corrections:
    """Integral action on the body's attitude and on forces, and on its place if asked."""

    def __init__(self, tables: RegulatorTables, place: bool = True) -> None:
        n, joints = tables.most.shape
        self.tables, self._place = tables, place
        self._last = len(tables.com) - 1
        self._least = -tables.most
        self._settled = [one > 0.5 for one in tables.settled.tolist()]
        # Of the toes [m]; at the start, how far they stand off their planned places
        self.offset = np.zeros((n, 3))
        self.added = np.zeros((n, joints))  # to joint commands [rad]
        self._planned, self._missing = np.empty((n, joints)), np.empty((n, joints, 1))
        self._lag = self._missing[..., 0]
        self._deflected, self._column = np.empty((n, 3, 1)), np.empty((n, 3, 1))
        self._flat = self._deflected.reshape(-1)
        self._shared = np.empty(3 * n)
        self._moved = self._shared.reshape(n, 3)
        self._wide, self._told = np.empty((n, 3)), np.empty((n, 3))
        self._length, self._stands = np.empty((n, 1)), np.empty((n, 1))
        self._com, self._step = np.empty(3), np.empty(3)
        self._wanted, self._change, self._skew = (np.empty((3, 3)) for _ in range(3))
        self._add = self.added[..., None]

    def update(
        self, sample: float, seconds: float, com: Array, rotation: Array, lag: Array
    ) -> Array:
        """(N, J) what to add to the joint commands [rad], overwritten by the next call.

        sample: of the plan, between two of its samples. com, rotation: where the body is. lag:
        (N, J) how far joints are from what they were last told, less what carries links [rad].
        """
        tables = self.tables
        at = min(int(sample), self._last)
        after, share = min(at + 1, self._last), sample - int(sample)
        _between(tables.bent[at], tables.bent[after], share, self._planned)
        np.maximum(lag, self._least, out=self._lag)
        np.minimum(self._lag, tables.most, out=self._lag)
        np.subtract(self._planned, self._lag, out=self._lag)
        np.matmul(tables.jacobian[at], self._missing, out=self._deflected)
        np.dot(tables.sharing[at], self._flat, out=self._shared)
        moved = self._moved
        np.multiply(moved, -FORCE_RATE, out=moved)
        if self._settled[at]:
            self._departure(at, after, share, com, rotation)
        told = self._told
        np.multiply(moved, seconds, out=told)
        np.add(told, self.offset, out=told)
        np.multiply(told, told, out=self._wide)
        np.add.reduce(self._wide, axis=1, out=self._length, keepdims=True)
        np.sqrt(self._length, out=self._length)
        np.maximum(self._length, MOST_OFFSET, out=self._length)
        np.divide(MOST_OFFSET, self._length, out=self._length)
        np.multiply(told, self._length, out=told)
        # In the air back to zero
        np.copyto(self._stands[:, 0], tables.contact[at])
        np.multiply(self.offset, max(0.0, 1.0 - BACK * seconds), out=self.offset)
        np.subtract(told, self.offset, out=told)
        np.multiply(told, self._stands, out=told)
        np.add(self.offset, told, out=self.offset)
        return self.told(at)

    def told(self, sample: int) -> Array:
        """(N, J) what offsets add to the joint commands at a sample of the plan [rad]."""
        np.copyto(self._column[..., 0], self.offset)
        np.matmul(self.tables.turning[sample], self._column, out=self._add)
        return self.added

    def _departure(self, at: int, after: int, share: float, com: Array, rotation: Array) -> None:
        """A body that is to move by (shift, turn) sees its toes move the other way."""
        tables, wide = self.tables, self._wide
        _between(tables.rotation[at], tables.rotation[after], share, self._wanted)
        np.dot(self._wanted, rotation.T, out=self._change)
        (_, o01, o02), (o10, _, o12), (o20, o21, _) = self._change.tolist()
        x, y, z = (o21 - o12) / 2, (o02 - o20) / 2, (o10 - o01) / 2
        _fill(self._skew, 0.0, -z, y, z, 0.0, -x, -y, x, 0.0)
        np.dot(tables.arms[at], self._skew.T, out=wide)
        if self._place:
            _between(tables.com[at], tables.com[after], share, self._com)
            np.subtract(self._com, com, out=self._step)
            np.add(wide, self._step, out=wide)
        np.multiply(wide, tables.rate[at], out=wide)
        np.subtract(self._moved, wide, out=self._moved)


class JointRegulator:
    """Commands at any time of a plan, corrected by what the joints' encoders say."""

    def __init__(
        self, tables: RegulatorTables, place: bool = True, toes: Array | None = None
    ) -> None:
        """toes: (N, 3) where they stand at the start, as far as is known [m]; as planned."""
        self._tables = tables
        self._times = tables.time.tolist()
        self._at, self._now = 0, self._times[0]
        self._chains = chains_of(tables)
        self.pose = Pose(tables, toes)
        self.corrections = Corrections(tables, place)
        if toes is not None:
            self.corrections.offset[:] = toes - tables.toes
        self.command = tables.command[0] + self.corrections.told(0)
        self._lag, self._angles = np.empty_like(self.command), np.empty_like(self.command)

    @property
    def end(self) -> float:
        """Of the plan [s]."""
        return float(self._times[-1])

    def tick(self, time: float, angles: Array) -> Array:
        """(N, J) commands for now [rad], overwritten by the next tick.

        time: of the plan [s], never less than at the tick before; after its end commands are held
        and corrected on. angles: (N, J) that encoders read [rad]. Raises ValueError where time goes
        back or an angle is no number.
        """
        seconds, times, tables = time - self._now, self._times, self._tables
        if not seconds >= 0.0:
            raise ValueError(f"time goes back: {time!r} after {self._now!r}")
        at, last = self._at, len(times) - 1
        while at < last and times[at + 1] <= time:
            at += 1
        share = (time - times[at]) / (times[at + 1] - times[at]) if at < last else 0.0
        np.subtract(angles, self.command, out=self._lag)
        np.multiply(self._lag, tables.give, out=self._lag)
        np.add(self.command, self._lag, out=self._angles)
        if not isfinite(float(np.add.reduce(self._angles, axis=None))):
            raise ValueError("an angle is no number")
        self._at, self._now = at, time
        self.pose.update(at + 1 if share > 0.0 else at, self._chains.place(self._angles))
        added = self.corrections.update(
            at + share, seconds, self.pose.com, self.pose.rotation, self._lag
        )
        _between(tables.command[at], tables.command[min(at + 1, last)], share, self.command)
        np.add(self.command, added, out=self.command)
        return self.command


def _between(before: Array, after: Array, share: float, out: Array) -> None:
    np.subtract(after, before, out=out)
    np.multiply(out, share, out=out)
    np.add(out, before, out=out)


def _fill(
    out: Array, a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float,
    i: float,
) -> None:  # fmt: skip
    out[0, 0], out[0, 1], out[0, 2] = a, b, c
    out[1, 0], out[1, 1], out[1, 2] = d, e, f
    out[2, 0], out[2, 1], out[2, 2] = g, h, i


def _turn_matrix(x: float, y: float, z: float, angle: float, out: Array) -> None:
    """Rotation about a unit vector by an angle [rad]."""
    c, s = cos(angle), sin(angle)
    k = 1.0 - c
    _fill(
        out, c + k * x * x, k * x * y - s * z, k * x * z + s * y,
        k * x * y + s * z, c + k * y * y, k * y * z - s * x,
        k * x * z - s * y, k * y * z + s * x, c + k * z * z,
    )  # fmt: skip
