"""What a simulated run assumes beside the plan: motors, masses, contacts, disturbances."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from climbplan.errors import UsageError
from climbplan.robots.model import Robot
from climbplan.simulation.world import World

Regulated = Literal["nothing", "attitude", "joints", "pose"]

# Robot data say that the mass acts at the body's origin, so links weigh next to nothing. (Half of
# a SiLVIA is limbs: 18 links of 0.3 kg beside a body of 5 kg in its authors' walking code.)
LIMB_MASS_SHARE = 0.02
MAX_REPLANS = 2  # of a run in closed loop


@dataclass(frozen=True)
class FrictionLoss:
    """A toe without friction for a while (dust, a loose plate)."""

    limb: int
    start: float  # [s] of the plan's time
    duration: float  # [s]


@dataclass(frozen=True)
class WeakMotor:
    """A motor of a climbing robot that gives less torque than the plan knows."""

    limb: int
    joint: int
    torque_fraction: float  # of its largest torque


@dataclass(frozen=True)
class Conditions:
    """One simulated world."""

    friction: float = 1.0  # factor on the terrain's coefficients
    payload: float = 0.0  # mass at the body origin that the plan does not know [kg]
    gain: float = 1.0  # factor on the joints' stiffness
    # Part of the robot's mass that is in its links, evenly; None: what its URDF says of each, or
    # of robots without one LIMB_MASS_SHARE
    limb_mass_share: float | None = None
    armature: float = 1.0  # factor on the rotors' inertia, or
    armature_value: float | None = None  # that of all joints [kg m^2], [kg]
    damping: float = 1.0  # factor on the joints' derivative gains and viscous friction, or
    damping_value: float | None = None  # the gain of all joints [N m s/rad], [N s/m]
    backlash: float = 0.0  # of every joint [rad]
    limb_weights: bool = True  # motors are told to carry the links' weight
    losses: tuple[FrictionLoss, ...] = field(default=())
    weak_motors: tuple[WeakMotor, ...] = field(default=())  # of climbs and transitions
    speed: float = 1.0  # factor on the plan's pace
    regulator: Regulated | None = None  # what of the body's pose commands are corrected for
    delay: float = 0.0  # that corrections come late [s]
    joint_noise: float = 0.0  # standard deviation of what the joints' sensors tell [rad]
    noise_seed: int = 0
    closed_loop: bool = False  # contacts are measured before the plan goes on
    max_replans: int = MAX_REPLANS  # plans from measured stances, in closed loop
    torque_error: float = 0.05  # standard deviation of the scale of each motor's measured torque
    world: World | None = None  # what robot and terrain are beside this; None: as planned


NOMINAL = Conditions()


def select_regulator(conditions: Conditions, robot: Robot) -> Regulated:
    """Return what a robot's commands are corrected for: what conditions say, or what can be.

    The regulator moves toes that are points, in places. Flat feet lie on their surfaces, and turn
    with the body where they stand: raises UsageError for what would correct them.
    """
    if robot.sole is None:
        return conditions.regulator or "joints"
    if conditions.regulator not in (None, "nothing"):
        raise UsageError(
            f"--regulate {conditions.regulator}: the regulator knows toes, not flat feet; expected "
            "nothing"
        )
    return "nothing"


_LEAST_BODY = 0.05  # of the robot's mass that a body keeps whose load is taken off


def require_possible(conditions: Conditions, mass: float, links: float | None = None) -> None:
    """Raise UsageError for a world that cannot be; mass: of the robot, and of its links [kg]."""
    for name, value in vars(conditions).items():
        if isinstance(value, float) and not math.isfinite(value):
            raise UsageError(f"--{name.replace('_', '-')} {value}: expected a finite number")
    if links is None:
        mass_fraction = conditions.limb_mass_share
        links = mass * (LIMB_MASS_SHARE if mass_fraction is None else mass_fraction)
    if mass - links + conditions.payload < _LEAST_BODY * mass:
        min_payload = links - (1 - _LEAST_BODY) * mass
        raise UsageError(
            f"--payload {conditions.payload:g}: expected at least {min_payload:.3g} kg"
        )
