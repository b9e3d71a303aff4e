"""What compiled functions hand each other: named arrays, N limbs of J joints."""

from __future__ import annotations

from typing import NamedTuple

from climbplan.arrays import Array

NO_REGULATOR, BY_ATTITUDE, BY_JOINTS, BY_POSE = range(4)


class Ground(NamedTuple):
    """What toes meet, in one world."""

    solids: Array  # (G, F, 4) rows of A and b of {A x <= b}, padded with zeros and ones
    friction: Array  # (G,)
    tubes: Array  # (U, 5) x, y, radius, z from, z to [m]
    tube_friction: Array  # (U,)


class Springs(NamedTuple):
    """What joints are in one step."""

    command: Array  # (N, J) [rad]
    weight: Array  # (N, J) torque of the links' own weight [N m]
    stiffness: Array  # (N, J) [N m/rad]
    half: Array  # (N, J) of the play, to either side [rad]
    loose: Array  # (N, J) stiffness within the play [N m/rad]
    volume: Array  # (N,) of each limb's Jacobian where it was last looked at [m^3]
    soft: Array  # (N,) compliance of toes in this step, 0 but of nearly straight limbs [m/N]


class Stand(NamedTuple):
    """Toes at the start of a step."""

    touching: Array  # (N,) 0 or 1
    solid: Array  # (N,) number of the solid or tube
    face: Array  # (N,) of the solid; TUBE
    anchor: Array  # (N, 3) where it stands; in the air, where it is [m]
    slippery: Array  # (N,) 1 without friction
    corner: Array  # (N, 2) solid and face that also hold a toe in a corner, -1 if none
    coarse: Array  # (1,) 1 where the step is too long for a toe to land in
    swift: Array  # (1,) 1 where it is short


class Touch(NamedTuple):
    """Toes at its end."""

    state: Array  # (N,) AIR, STICKS, SLIDES
    solid: Array
    face: Array
    place: Array  # (N, 3) [m]
    normal: Array  # (N, 3)
    force: Array  # (N, 3) on the toe, world [N]
    angles: Array  # (N, J) [rad]
    saturated: Array  # (N,) 1 with a motor at its limit


class Motors(NamedTuple):
    """Motors at the start of a step, and what they are told."""

    rotor: Array  # (N, J) before the play [rad]
    angles: Array  # (N, J) behind it [rad]
    speed: Array  # (N, J) of the rotors [rad/s]
    wanted: Array  # (N, J) [rad]


class Known(NamedTuple):
    """What a regulator knows and has done."""

    toes: Array  # (N, 3) where they are believed to stand [m]
    stood: Array  # (N,) toes it counted on at the last step, 0 or 1
    com: Array  # (3,) believed [m]
    rotation: Array  # (3, 3) believed
    offset: Array  # (N, 3) of each toe's commands [m]
    before: Array  # (N, 3) of them before a step that may be taken again [m]
    told: Array  # (N, J) commands of the last step, before motors give in [rad]
    sent: Array  # (N, J) and of this one
    lag: Array  # (N, J) room: of joints behind what they were told [rad]
    toe_lag: Array  # (N, 3) room: of toes by it [m]
    local: Array  # (N, 3) room: toes from the body [m]
    reading: Array  # (N, J) angles that sensors tell over a step, on average [rad]
    once: Array  # (N, J) and once [rad]
    draws: Array  # (1,) errors of sensors drawn so far
    late: Array  # (N, 3) offsets that have reached the motors [m]
    when: Array  # (H,) at which offsets were what they were, the last H, around in a ring [s]
    past: Array  # (H, N, 3) what they were [m]
    kept: Array  # (1,) how many were


class Feet(NamedTuple):
    """Where toes were set down, and how far they slid since."""

    set_down: Array  # (N, 3) [m]
    slid: Array  # (N,) [m]


class Body(NamedTuple):
    """A rigid body on its way through a step; changed in place."""

    com: Array  # (3,) [m]
    rotation: Array  # (3, 3) to the world
    velocity: Array  # (6,) at the step's start [m/s, rad/s]
    moved: Array  # (6,) since then [m, rad]


class Load(NamedTuple):
    """What a body carries."""

    mass: float  # [kg]
    inertia: float  # [kg m^2], about any axis
    gravity: float  # [m/s^2]
    offset: Array  # (3,) of the mass, body frame [m]
    wrench: Array  # (6,) beside the weight [N, N m]


class Pad(NamedTuple):
    """Room to compute in: memory from the heap costs more than what is computed."""

    v: Array  # (12, 3)
    m: Array  # (8, 3, 3)
    wrench: Array  # (6,)
    matrix: Array  # (6, 6)
    taken: Array  # (6,)
    columns: Array  # (J, 3)
    axes: Array  # (J, 3)
    spread: Array  # (J, 3)
    joints: Array  # (4, J)
    square: Array  # (J, J)


class Playback(NamedTuple):
    """A plan's motion in S steps, the same in all worlds."""

    zero: Array  # (N, 2J + 1, 3) limbs at zero angles (`links.py`); a run moves toes of feet
    ends: Array  # (S, N, 3) toes of spherical feet at zero angles (`rolling_contact.py`), or S = 0
    span: Array  # (S,) of each step, simulated time [s]
    command: Array  # (S, N, J) joint commands, with what carries the links [rad]
    weight: Array  # (S, N, J) torque of the links' weight on joints [N m]
    carrying: Array  # (S, N, J) what commands have for it [rad]
    wrench: Array  # (S, 6) load beside the weight [N, N m]
    com: Array  # (S, 3) where the body should be [m]
    rotation: Array  # (S, 3, 3)
    stands: Array  # (S, N) toes that are to press, 0 or 1
    trusted: Array  # (S, N) toes that odometry counts on, 0 or 1
    contact: Array  # (S, N) toes that the regulator moves, 0 or 1
    settled: Array  # (S,) whether it may correct more, no toe being half loaded, 0 or 1
    turning: Array  # (S, N, J, 3) joint turns by toe motion in the world
    arm: Array  # (S, N, 3) from body to toe [m]
    jacobian: Array  # (S, N, 3, J) toe motion in the world by joint turns [m/rad]
    bent: Array  # (S, N, J) joint angles less commands, planned [rad]
    sharing: Array  # (S, 3N, 3N) of toe deflections what toes do to each other
    most: Array  # (N, J) that motors bend joints [rad]
    foothold: Array  # (S, N) number of the foothold a limb comes from
    share: Array  # (S, N) of the way to the next
    toes: Array  # (N, 3) where it is believed to be set up [m]


class Machine(NamedTuple):
    """The robot in one world."""

    mass: float  # [kg]
    inertia: float  # [kg m^2]
    gravity: float  # [m/s^2]
    offset: Array  # (3,) of the mass [m]
    stiffness: Array  # (N, J) [N m/rad]
    damping: Array  # (N, J) of motors [N m s/rad]
    armature: Array  # (N, J) rotor inertia behind the gears [kg m^2]
    play: Array  # (N, J) [rad]
    strongest: Array  # (N, J) [N m]
    placement: Array  # (N, P, 3) error of each foothold, world [m]
    losses: Array  # (L, 3) limb, first and last step without friction
    toes: Array  # (N, 3) where it is set up [m]
    angles: Array  # (N, J) there [rad]
    regulator: int  # NO_REGULATOR, BY_ATTITUDE, ...
    delay: float  # [s] that its corrections come late
    noise: Array  # (D, N, J) errors of single readings of joints, in turn; D = 0: exact [rad]
