"""The walking task in numbers: body, terrain, start, references and weights.

Axes of chapter 8.2: body frame x forward, y to the left, z up; world frame z up. Legs are always
in the order of `RigidBody.leg_names`.

Equation, chapter and table numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.task.ground import Ground

Integrator = Literal["euler", "mean", "rk4"]

STATE = 12  # position, velocity, Z-Y-X Euler angles (roll, pitch, yaw), angular velocity (world)
POSITION, VELOCITY, ANGLES, SPIN = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
ANGLE_RANGE = np.pi / 2  # [rad] Table 8.4
_MIN_SAMPLES, _MAX_SAMPLE_TIME = 16, 0.005  # [s]
RATE_RANGE = 10.0  # [rad/s] Table 8.4, of Euler rates and of the angular velocity


class BodyParameters(NamedTuple):
    """The mass properties of a rigid body, as compiled functions take them."""

    mass: float  # [kg]
    gravity: float  # [m/s^2]
    inertia: Array  # (3, 3) about the centre of mass, body frame [kg m^2]
    inverse_inertia: Array  # (3, 3)


class ToeWorkspace(NamedTuple):
    """The boxes within which toes must stay, body frame."""

    center: Array  # (L, 3) [m]
    half: Array  # (3,) half extents [m]


@dataclass(frozen=True)
class RigidBody:
    """A legged robot as a single rigid body with massless legs."""

    name: str
    leg_names: tuple[str, ...]
    mass: float  # [kg]
    inertia: Array  # (3, 3) about the centre of mass, body frame [kg m^2]
    gravity: float  # [m/s^2]
    toe_center: Array  # (L, 3) middle of each toe's workspace box, body frame [m]
    toe_half: Array  # (3,) half extents of the boxes [m]
    force_limit: float  # [N] of each component of a contact force

    @property
    def leg_count(self) -> int:
        """Number L of legs, in pairs from front to hind as in `leg_order`."""
        return len(self.leg_names)

    @cached_property
    def inverse(self) -> Array:
        """The inverse (3, 3) of the inertia."""
        return np.linalg.inv(self.inertia).astype(float)

    @cached_property
    def parameters(self) -> BodyParameters:
        """Mass properties as compiled functions take them."""
        return BodyParameters(self.mass, self.gravity, self.inertia, self.inverse)

    @cached_property
    def toe_workspace(self) -> ToeWorkspace:
        """The toes' boxes as compiled functions take them."""
        return ToeWorkspace(self.toe_center, self.toe_half)


@dataclass(frozen=True)
class Start:
    """The first state of the body and the first positions of the toes."""

    state: Array  # (12,)
    toes: Array  # (L, 3) world frame [m]


@dataclass(frozen=True)
class Reference:
    """The references at knots 1 to N."""

    velocity: Array  # (N, 3) world frame [m/s]
    euler: Array  # (N, 3) roll, pitch, yaw [rad]
    height: Array  # (N,) of the centre of mass [m]


@dataclass(frozen=True)
class Weights:
    """Weights of eq. (8.30)."""

    velocity: Array  # (3,)
    angles: Array  # (3,)
    height: float
    motion: float  # on the squared body step
    force_difference: float  # [1/N^2] on squared differences between legs' forces


@dataclass(frozen=True)
class Goal:
    """A box for the centre of mass at the last knot."""

    lower: Array  # (2,) x, y [m]
    upper: Array  # (2,)

    @classmethod
    def anywhere(cls) -> Goal:
        """Return the unbounded goal."""
        return cls(np.full(2, -np.inf), np.full(2, np.inf))

    @property
    def is_set(self) -> bool:
        """True if there is a goal."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    def compute_violation(self, position: Array) -> Array:
        """Return how far points (..., 2) are outside the goal [m], <= 0 inside."""
        off: Array = np.maximum(self.lower - position, position - self.upper).max(axis=-1)
        return off


@dataclass(frozen=True)
class WalkTask:
    """A walking problem of chapter 8.2.1."""

    body: RigidBody
    ground: Ground
    knots: int  # N intervals
    dt: float  # [s]
    integrator: Integrator
    start: Start
    reference: Reference
    weights: Weights
    swing_clearance: float  # [m] of a swinging toe above the ground it leaves and reaches
    min_contacts: int  # standing legs in every interval
    # Standing toes stay in their boxes until the interval's end
    workspace_over_stance: bool = False
    goal: Goal = field(default_factory=Goal.anywhere)
    legs: WalkingLegs | None = None  # joints with torque limits of a URDF robot
    first: float = 0.0  # [s] length of the first interval if a plan begins between knots; 0: `dt`

    @cached_property
    def steps(self) -> Array:
        """Lengths of the intervals (N,) [s]."""
        lengths = np.full(self.knots, self.dt)
        if self.first:
            lengths[0] = self.first
        return lengths

    @property
    def samples(self) -> int:
        """Samples of a closed loop in an interval, at least every 5 ms."""
        return max(_MIN_SAMPLES, round(self.dt / _MAX_SAMPLE_TIME))

    @property
    def sample(self) -> float:
        """Time between two samples of a closed loop [s]."""
        return self.dt / self.samples

    @cached_property
    def hips(self) -> Array:
        """Points (L, 3) where legs are drawn to begin, body frame [m].

        They are the first joints; without joints, points above the middles of the workspaces.
        """
        if self.legs is not None:
            return self.legs.chain.joint_zero[:, 0]
        level: Array = self.body.toe_center * [1.0, 1.0, 0.0]
        return level

    @property
    def weight(self) -> float:
        """Weight of the robot [N]."""
        return self.body.mass * self.body.gravity


@dataclass(frozen=True)
class Gait:
    """The integers of a plan of N intervals: contacts and regions."""

    contact: BoolArray  # (N + 1, L) leg is in contact from this knot to the next
    region: IntArray  # (N + 1, L) region of its stance, or of its next one

    @cached_property
    def key(self) -> bytes:
        """Equal for equal integers."""
        return np.packbits(self.contact).tobytes() + self.region.astype(np.int16).tobytes()


@dataclass(frozen=True)
class WalkTrajectory:
    """States, toes and contact forces of N intervals."""

    state: Array  # (N + 1, 12)
    toes: Array  # (N + 1, L, 3) world frame [m]
    force: Array  # (N + 1, L, 3) world frame [N], from knot n to n + 1; zeros at the last
    gait: Gait
