"""Named arrays that the compiled functions of the quasi-static simulator pass to each other.

A robot has N limbs of J joints. Arrays of flags hold integers 0 or 1, and are changed in place.
"""

from __future__ import annotations

from typing import NamedTuple

from climbplan.arrays import Array

NO_REGULATOR, BY_ATTITUDE, BY_JOINTS, BY_POSE = range(4)


class TerrainGeometry(NamedTuple):
    """The collision geometry of the terrain in one scenario."""

    solids: Array  # (G, F, 4) rows of A and b of {A x <= b}, padded with zeros and ones
    friction: Array  # (G,) friction coefficient
    tubes: Array  # (U, 5) x, y, radius, z from, z to [m]
    tube_friction: Array  # (U,)


class JointSprings(NamedTuple):
    """The joints in one time step, as springs with backlash about their commands."""

    command: Array  # (N, J) [rad]
    gravity_torque: Array  # (N, J) torque of the links' own weight [N m]
    stiffness: Array  # (N, J) [N m/rad]
    half_backlash: Array  # (N, J) backlash to either side [rad]
    backlash_stiffness: Array  # (N, J) stiffness within the backlash [N m/rad]
    jacobian_volume: Array  # (N,) of each limb where it was evaluated last [m^3]
    toe_compliance: Array  # (N,) in this step, 0 unless the limb is nearly straight [m/N]


class ContactState(NamedTuple):
    """The contacts at the start of a time step."""

    in_contact: Array  # (N,) 0 or 1
    solid: Array  # (N,) index of the solid or tube
    face: Array  # (N,) of the solid; TUBE
    anchor: Array  # (N, 3) where the toe stands; in the air, where it is [m]
    frictionless: Array  # (N,) 1 without friction
    corner_face: Array  # (N, 2) solid and face that also support a toe in a corner, -1 if none


class ContactSolution(NamedTuple):
    """The contacts at the end of a time step."""

    mode: Array  # (N,) AIR, STICKS, SLIDES
    solid: Array  # (N,) index of the solid or tube
    face: Array  # (N,) of the solid; TUBE
    position: Array  # (N, 3) of the toe, world [m]
    normal: Array  # (N, 3) of the surface, into free space
    force: Array  # (N, 3) on the toe, world [N]
    angles: Array  # (N, J) [rad]
    saturated: Array  # (N,) 1 if a motor is at its torque limit


class MotorState(NamedTuple):
    """Motors at the start of a time step, and their set points for its end."""

    rotor_angle: Array  # (N, J) before the backlash [rad]
    joint_angle: Array  # (N, J) behind it [rad]
    rotor_speed: Array  # (N, J) [rad/s]
    reference: Array  # (N, J) [rad]


class RegulatorState(NamedTuple):
    """The state of the regulator and of its odometry."""

    toes: Array  # (N, 3) estimated places of the toes that stand [m]
    stood: Array  # (N,) toes that odometry trusted in the step before, 0 or 1
    com: Array  # (3,) estimated position of the body [m]
    rotation: Array  # (3, 3) estimated, body to world
    offset: Array  # (N, 3) correction of each toe's command [m]
    accepted_offset: Array  # (N, 3) corrections after the last step that was accepted [m]
    last_command: Array  # (N, J) of the last accepted step, before torque limits [rad]
    command: Array  # (N, J) of the step in progress [rad]
    joint_error: Array  # (N, J) measured angles less the last commands, gravity removed [rad]
    toe_error: Array  # (N, 3) toe deflection that is missing to the planned one [m]
    toe_body: Array  # (N, 3) toes by measured angles, body frame [m]
    mean_reading: Array  # (N, J) measured angles, averaged over a step [rad]
    single_reading: Array  # (N, J) one measurement of the angles [rad]
    num_draws: Array  # (1,) sensor errors drawn so far
    delayed_offset: Array  # (N, 3) corrections that have reached the motors [m]
    history_time: Array  # (H,) times of the last H corrections, a ring buffer [s]
    history_offset: Array  # (H, N, 3) these corrections [m]
    num_recorded: Array  # (1,) corrections written to the ring buffer so far


class FootSlip(NamedTuple):
    """Where toes touched down, and how far they have slipped from there."""

    touchdown: Array  # (N, 3) [m]
    distance: Array  # (N,) [m]


class BodyState(NamedTuple):
    """A rigid body in a time step; changed in place."""

    com: Array  # (3,) [m]
    rotation: Array  # (3, 3) to the world
    velocity: Array  # (6,) at the step's start [m/s, rad/s]
    displacement: Array  # (6,) since then [m, rad]


class BodyLoad(NamedTuple):
    """Inertia of the body and the loads on it."""

    mass: float  # [kg]
    inertia: float  # [kg m^2], about any axis
    gravity: float  # [m/s^2]
    mass_offset: Array  # (3,) centre of mass, body frame [m]
    external_wrench: Array  # (6,) in addition to the weight [N, N m]


class SimulationState(NamedTuple):
    """A simulated robot and its contacts; all arrays are changed in place."""

    body: BodyState
    saved_body: BodyState  # pose before the time step, to which a step without solution returns
    load: BodyLoad
    contacts: ContactState
    solution: ContactSolution
    springs: JointSprings
    motors: MotorState
    regulator: RegulatorState
    slip: FootSlip


class TimeStep(NamedTuple):
    """A time step, which is a part of a planned step."""

    planned_step: int
    elapsed: float  # fraction of the planned step that is done before
    fraction: float  # of the planned step
    span: float  # [s]
    is_moving: bool  # the motion has begun: the robot has settled at the first commands
    clock: float  # time since the motion began, at the start of the step [s]


class StepSettings(NamedTuple):
    """How one time step is solved; all of it follows from its length."""

    span: float  # [s]
    project_forces: bool  # contact forces by projection on the cone, unique in short steps
    forbid_landing: bool  # the step is too long to locate a touchdown, or a stop at a wall
    accept_rough: bool  # accept a residual that is nearly balanced: toes snap between places


class ScratchMemory(NamedTuple):
    """Memory of the compiled functions: allocation would cost more than what they compute.

    Named fields are results that the caller reads. Rows of `vectors`, `matrices` and
    `joint_vectors` are temporaries, with the numbers of `memory_rows.py`.
    """

    residual: Array  # (6,) unbalanced force and moment on the body [N, N m]
    stiffness: Array  # (6, 6) -d residual / d (translation, rotation) of the body
    newton_step: Array  # (6,) last step of the body [m, rad]
    force_projection: Array  # (3, 3) P of a toe's force change, see `contact._solve_contact`
    contact_stiffness: Array  # (3, 3) G of a toe's force change, world frame [N/m]
    jacobian: Array  # (J, 3) columns of a limb's Jacobian, body frame [m/rad]
    joint_axes: Array  # (J, 3) of a limb, body frame
    vectors: Array  # (NUM_VECTORS, 3)
    matrices: Array  # (NUM_MATRICES, 3, 3)
    joint_vectors: Array  # (NUM_JOINT_VECTORS, J)
    joint_response: Array  # (J, 3) joint angles by the force at the toe [rad/N]
    joint_matrix: Array  # (J, J)


class PlannedMotion(NamedTuple):
    """A plan's motion in S time steps, the same in all scenarios."""

    zero_pose: Array  # (N, 2J + 1, 3) limbs at zero angles (`limb_kinematics.py`); toes may move
    contact_points: Array  # (S, N, 3) of spherical feet at zero angles (`rolling_contact.py`); S=0
    duration: Array  # (S,) of each step, simulated time [s]
    command: Array  # (S, N, J) joint commands, gravity feedforward included [rad]
    gravity_torque: Array  # (S, N, J) torque of the links' weight on joints [N m]
    feedforward: Array  # (S, N, J) part of the commands that compensates for gravity [rad]
    external_wrench: Array  # (S, 6) load in addition to the weight [N, N m]
    com: Array  # (S, 3) planned position of the body [m]
    rotation: Array  # (S, 3, 3) planned, body to world
    should_press: Array  # (S, N) toes that are planned to press, 0 or 1
    trusted: Array  # (S, N) toes that odometry relies on, 0 or 1
    contact: Array  # (S, N) toes that the regulator moves, 0 or 1
    allow_pose_correction: Array  # (S,) no toe is half loaded, 0 or 1
    jacobian_inverse: Array  # (S, N, J, 3) damped, joint motion by toe motion in the world [rad/m]
    moment_arm: Array  # (S, N, 3) from body to toe [m]
    jacobian: Array  # (S, N, 3, J) toe motion in the world by joint motion [m/rad]
    joint_deflection: Array  # (S, N, J) planned joint angles less commands [rad]
    internal_projector: Array  # (S, 3N, 3N) toe deflections onto those without body motion
    max_deflection: Array  # (N, J) of a joint at its motor's torque limit [rad]
    foothold: Array  # (S, N) index of the foothold that a limb comes from
    swing_phase: Array  # (S, N) fraction of the way to the next, 0 in contact
    initial_toes: Array  # (N, 3) where the robot believes that it is set up [m]


class RobotParameters(NamedTuple):
    """The robot in one scenario."""

    mass: float  # [kg]
    inertia: float  # [kg m^2]
    gravity: float  # [m/s^2]
    mass_offset: Array  # (3,) centre of mass, body frame [m]
    stiffness: Array  # (N, J) [N m/rad]
    damping: Array  # (N, J) of motors [N m s/rad]
    armature: Array  # (N, J) rotor inertia behind the gears [kg m^2]
    backlash: Array  # (N, J) [rad]
    max_torque: Array  # (N, J) [N m]
    foothold_error: Array  # (N, P, 3) error of each foothold, world [m]
    friction_losses: Array  # (L, 3) limb, first and last step without friction
    initial_toes: Array  # (N, 3) where the robot is set up [m]
    initial_angles: Array  # (N, J) joint angles there [rad]
    regulator: int  # NO_REGULATOR, BY_ATTITUDE, ...
    delay: float  # [s] of the regulator's corrections
    sensor_noise: Array  # (D, N, J) errors of joint readings, used in turn; D = 0: exact [rad]
