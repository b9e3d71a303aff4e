"""Simulate plans by implicit time steps: the interface of the compiled functions.

A plan is divided into time steps once (`prepare_steps`) and then simulated in many scenarios
(`simulate_steps`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.climb.simulation.comparison import MIN_STANCE_PRESSURE, find_stance
from climbplan.climb.simulation.control.feedforward import (
    compute_gravity_torques,
    compute_links_wrench,
)
from climbplan.climb.simulation.control.odometry import find_trusted_toes
from climbplan.climb.simulation.control.planned_pressure import compute_planned_pressure
from climbplan.climb.simulation.control.regulator import (
    build_internal_projector,
    compute_zero_pose,
    invert_jacobian,
)
from climbplan.climb.simulation.implicit_dynamics.rolling_contact import compute_contact_points
from climbplan.climb.simulation.implicit_dynamics.state import (
    BY_ATTITUDE,
    BY_JOINTS,
    BY_POSE,
    NO_REGULATOR,
    PlannedMotion,
    RobotParameters,
    TerrainGeometry,
)
from climbplan.climb.simulation.implicit_dynamics.time_stepping import simulate_motion
from climbplan.climb.simulation.initial_posture import place_robot
from climbplan.climb.simulation.model.toe import TOE_RADIUS
from climbplan.climb.simulation.worlds.nominal_world import build_nominal_world, number_footholds
from climbplan.climb.simulation.worlds.perturbed_terrain import (
    build_collision_solids,
    perturb_terrain,
)
from climbplan.errors import UsageError
from climbplan.mechanics.stiffness import joint_softness, limb_compliance
from climbplan.robots.chain_pose import RADIAN
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.kinematics import contact_points, jacobian_world, toe_world
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.conditions import Conditions, select_regulator
from climbplan.simulation.motors import (
    compute_assumed_stiffness,
    compute_backlash,
    compute_joint_damping,
    compute_max_torque,
    compute_motor_stiffness,
    compute_rotor_inertia,
)
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import Region, Tube

MAX_SPAN = 0.25  # [s] longest planned step, simulated time
DELAYED_SPAN = 0.1  # [s] with a delayed regulator
_UNKNOWN = "the statics engine does not know: `climbplan simulate --engine mujoco` does"
_NUM_NOISE_DRAWS = 4096  # sensor readings of a simulation whose errors differ
_REGULATORS = {
    "nothing": NO_REGULATOR, "attitude": BY_ATTITUDE, "joints": BY_JOINTS, "pose": BY_POSE
}  # fmt: skip


@dataclass(frozen=True)
class PreparedMotion:
    """A plan's motion, divided into S time steps."""

    motion: PlannedMotion
    sample: IntArray  # (S,) of the trajectory that each step ends at
    instant: IntArray  # (S,) planned instant it belongs to, -1 before the first


def prepare_steps(plan: ClimbPlan, conditions: Conditions) -> PreparedMotion:
    """Divide a plan into time steps, which are the same in all scenarios.

    Args:
        plan: The plan.
        conditions: Regulator, delay, speed and motors; the world in it does not count.

    Raises:
        UsageError: The plan is timed by its dynamics, or the robot has grippers, flat feet, five-
            bar legs, joints that mimic others, or not three or more joints in each limb alike.
    """
    robot, trajectory = plan.robot, plan.trajectory
    zero, unit = _build_zero_pose(plan), robot.joint_unit
    max_span = DELAYED_SPAN if conditions.delay > 0 else MAX_SPAN
    sample = _select_samples(plan, conditions.speed, max_span)
    instant = sample_instants(plan)
    angles = compute_true_angles(plan, instant)
    gravity_torque = -compute_gravity_torques(plan, conditions)
    feedforward = np.zeros_like(trajectory.joint_command)
    if conditions.limb_weights:
        feedforward = -gravity_torque / compute_assumed_stiffness(robot, conditions)
    command = trajectory.joint_command + feedforward
    external_wrench = plan.instants.external_wrench[np.maximum(instant, 0)]
    external_wrench = external_wrench + compute_links_wrench(plan, conditions)
    jacobian = jacobian_world(robot, trajectory.rpy[sample], angles[sample])
    jacobian_inverse = invert_jacobian(jacobian)
    max_deflection = joint_softness(robot) * robot.max_torque
    deflection = (angles - trajectory.joint_command)[sample]
    toes = toe_world(robot, trajectory.com[sample], trajectory.rpy[sample], angles[sample])
    moment_arm = toes - trajectory.com[sample][:, None]
    contact, trusted = trajectory.contact[sample], find_trusted_toes(plan)[sample]
    projector = build_internal_projector(limb_compliance(robot, jacobian), moment_arm, contact)
    footholds = number_footholds(trajectory.contact)
    should_press = find_stance(plan) & (compute_planned_pressure(plan) >= MIN_STANCE_PRESSURE)
    duration = np.diff(trajectory.time[sample], prepend=trajectory.time[0]) / conditions.speed
    contiguous = np.ascontiguousarray
    motion = PlannedMotion(
        zero_pose=zero,
        contact_points=compute_contact_points(plan, sample, angles, zero[:, 2 * robot.joint_count]),
        duration=duration,
        command=contiguous(command[sample] / unit),
        gravity_torque=contiguous(gravity_torque[sample] * unit),
        feedforward=contiguous(feedforward[sample] / unit),
        external_wrench=contiguous(external_wrench[sample]),
        com=contiguous(trajectory.com[sample]),
        rotation=contiguous(rotation_world_body(trajectory.rpy[sample])),
        should_press=contiguous(should_press[sample].astype(np.int64)),
        trusted=contiguous(trusted.astype(np.int64)),
        contact=contiguous(contact.astype(np.int64)),
        allow_pose_correction=contiguous((trusted == contact).all(axis=1).astype(np.int64)),
        jacobian_inverse=contiguous(jacobian_inverse / unit[..., None]),
        moment_arm=contiguous(moment_arm),
        jacobian=contiguous(jacobian * unit[:, None]),
        joint_deflection=contiguous(np.clip(deflection, -max_deflection, max_deflection) / unit),
        internal_projector=contiguous(projector),
        max_deflection=contiguous(max_deflection / unit),
        foothold=contiguous(footholds.index[sample]),
        swing_phase=contiguous(footholds.swing_phase[sample]),
        initial_toes=contact_points(robot, plan.rounds.toes[0], plan.instants.normal[0]),
    )
    return PreparedMotion(motion, sample, instant[sample])


def simulate_steps(
    plan: ClimbPlan, steps: PreparedMotion, conditions: Conditions, path: Array | None = None
) -> Array:
    """Simulate a plan under conditions, in their world.

    Args:
        plan: The plan.
        steps: Its motion by `prepare_steps`.
        conditions: Conditions with a world; None is the nominal one.
        path: (S, 3 + 6 N) filled with the body's position, the toes [m] and the forces on them [N],
            world frame; None records nothing.

    Returns:
        (COLUMNS,) the outcome, with the columns of `outcome.py`.
    """
    terrain = perturb_terrain(plan.terrain, conditions.world or build_nominal_world(plan))
    robot = build_robot(plan, terrain, steps, conditions)
    ground = build_ground(plan, terrain, conditions)
    if path is None:
        path = np.zeros((0, 3 + 6 * plan.robot.limb_count))
    motion = steps.motion._replace(
        zero_pose=_copy_zero_pose(steps.motion)
    )  # changed by the simulation
    return simulate_motion(motion, robot, ground, path)


def _copy_zero_pose(motion: PlannedMotion) -> Array:
    """Copy the limbs at zero angles, with the contact points of the first step."""
    zero_pose = motion.zero_pose.copy()
    if len(motion.contact_points):
        zero_pose[:, 2 * motion.command.shape[2]] = motion.contact_points[0]
    return zero_pose


def build_robot(
    plan: ClimbPlan, terrain: Terrain, steps: PreparedMotion, conditions: Conditions
) -> RobotParameters:
    """Build the robot under conditions, in their world, set up on its terrain."""
    robot, world = plan.robot, conditions.world or build_nominal_world(plan)
    mass = robot.mass * world.mass + conditions.payload
    half_size = np.abs(robot.body_hull).max(axis=0)
    unit = robot.joint_unit
    stiffness = compute_motor_stiffness(robot, conditions) * unit**2
    start = place_robot(plan, terrain)
    toes = start.toes
    if robot.foot is not None:
        surfaces = [terrain.surfaces[r] for r in plan.rounds.region[0]]
        toes = toes + robot.foot.arm(
            np.array([s.normal_at(toe) for s, toe in zip(surfaces, toes, strict=True)])
        )
    times = plan.trajectory.time[steps.sample]
    friction_losses = [
        (x.limb, *np.searchsorted(times, [x.start, x.start + x.duration]))
        for x in conditions.losses
    ]
    return RobotParameters(
        mass=float(mass),
        inertia=float(mass * 2 * (half_size**2).sum() / 9),  # mean of a box's three
        gravity=float(robot.gravity),
        mass_offset=world.com.copy(),
        stiffness=np.ascontiguousarray(stiffness),
        damping=np.ascontiguousarray(compute_joint_damping(robot, conditions) * unit**2),
        armature=np.ascontiguousarray(compute_rotor_inertia(robot, conditions) * unit**2),
        backlash=compute_backlash(robot, conditions) / unit,
        max_torque=np.ascontiguousarray(compute_max_torque(robot, conditions) * unit),
        foothold_error=np.ascontiguousarray(world.placement),
        friction_losses=np.array(friction_losses, float).reshape(-1, 3),
        initial_toes=np.ascontiguousarray(toes),
        initial_angles=np.ascontiguousarray(start.angles / unit),
        regulator=_REGULATORS[select_regulator(conditions, plan.robot)],
        delay=conditions.delay,
        sensor_noise=_draw_sensor_noise(robot.limb_count, robot.joint_count, conditions),
    )


def _draw_sensor_noise(limbs: int, joints: int, conditions: Conditions) -> Array:
    """Draw errors (D, N, J) of joint readings [rad], used in turn; D = 0 without noise."""
    size = _NUM_NOISE_DRAWS if conditions.joint_noise > 0 else 0
    rng = np.random.default_rng(conditions.noise_seed)
    return rng.normal(0.0, conditions.joint_noise, (size, limbs, joints))


def build_ground(plan: ClimbPlan, terrain: Terrain, conditions: Conditions) -> TerrainGeometry:
    """Build the collision geometry of a scenario's terrain under conditions."""
    regions = [s for s in terrain.surfaces if isinstance(s, Region)]
    tube_surfaces = [s for s in terrain.surfaces if isinstance(s, Tube)]
    friction = [region.friction for region in regions]
    friction += [float(np.min(plan.instants.mu))] * len(terrain.obstacles)
    tubes = [(*t.center, t.radius + t.standoff, t.lower, t.upper) for t in tube_surfaces]
    # Toes of feet are where these touch; points have a small radius, as MuJoCo's have
    radius = TOE_RADIUS if plan.robot.foot is None else 0.0
    return TerrainGeometry(
        solids=build_collision_solids(terrain, radius),
        friction=np.array(friction, float) * conditions.friction,
        tubes=np.array(tubes, float).reshape(-1, 5),
        tube_friction=np.array([t.friction for t in tube_surfaces], float) * conditions.friction,
    )


def _select_samples(plan: ClimbPlan, speed: float, max_span: float) -> IntArray:
    """Select the samples at which steps end: on both sides of changes of contact, and between.

    max_span: longest simulated time between two of them [s].
    """
    time = plan.trajectory.time
    states = np.hstack([plan.trajectory.contact, find_trusted_toes(plan)])
    change = np.flatnonzero((states[1:] != states[:-1]).any(axis=1))
    forced = np.unique(np.concatenate([[0, len(time) - 1], *(change + k for k in range(4))]))
    forced = forced[forced < len(time)]
    samples = [forced[:1]]
    for first, last in pairwise(forced.tolist()):
        num_pieces = max(1, int(np.ceil((time[last] - time[first]) / speed / max_span - 1e-9)))
        num_pieces = min(num_pieces, int(last - first))
        samples.append(np.rint(np.linspace(first, last, num_pieces + 1)[1:]).astype(np.int64))
    return np.concatenate(samples)


def _build_zero_pose(plan: ClimbPlan) -> Array:
    """Build limbs (N, 2J + 1, 3) at zero angles: axes and places of joints, and the toe.

    Directions of prismatic joints follow, (N, 3J + 1, 3) in all; their lengths count in `RADIAN`.
    Raises UsageError for plans and robots that the engine does not know.
    """
    if plan.trajectory.is_paced:
        raise UsageError(f"{plan.name} is timed by its inertia (trajectory.pace), which {_UNKNOWN}")
    robot = plan.robot
    if robot.gripper is not None:
        raise UsageError(f"{plan.name}: {robot.name} has grippers, which {_UNKNOWN}")
    if isinstance(robot.mechanism, FiveBar):
        raise UsageError(f"{plan.name}: {robot.name} has five-bar legs, which {_UNKNOWN}")
    if robot.joint_count < 3:
        raise UsageError(
            f"{plan.name}: limbs of {robot.name} have fewer than three joints, which {_UNKNOWN}"
        )
    if robot.sole is not None:
        raise UsageError(f"{plan.name}: {robot.name} has flat feet, which {_UNKNOWN}")
    if isinstance(robot.mechanism, SerialChain) and robot.mechanism.drive is not None:
        raise UsageError(
            f"{plan.name}: limbs of {robot.name} have joints that mimic others, which {_UNKNOWN}"
        )
    if not robot.has_joint.all():
        raise UsageError(
            f"{plan.name}: limbs of {robot.name} have unlike numbers of joints, which {_UNKNOWN}"
        )
    pose = compute_zero_pose(robot)
    assert pose is not None
    rows = [pose.axes, pose.joints, pose.toe[:, None]]
    if pose.slides is not None:
        rows.append(RADIAN * pose.slides)
    return np.concatenate(rows, axis=1).copy()
