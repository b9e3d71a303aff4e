"""What the compiled run is given: a plan's motion in steps, robot and terrain of a world."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants, true_angles
from climbplan.climb.simulation.comparison import LEAST_HELD, held_toes
from climbplan.climb.simulation.control.feedforward import limb_weight_torques, limb_weight_wrench
from climbplan.climb.simulation.control.odometry import standing
from climbplan.climb.simulation.control.planned_pressure import planned_pressure
from climbplan.climb.simulation.control.regulator import between_toes, turning_of, zero_angles
from climbplan.climb.simulation.model.toe import TOE_RADIUS
from climbplan.climb.simulation.start import set_up
from climbplan.climb.simulation.statics.rolling_contact import contact_ends
from climbplan.climb.simulation.statics.run import play
from climbplan.climb.simulation.statics.tuples import (
    BY_ATTITUDE,
    BY_JOINTS,
    BY_POSE,
    NO_REGULATOR,
    Ground,
    Machine,
    Playback,
)
from climbplan.climb.simulation.worlds.ground import material, moved_terrain
from climbplan.climb.simulation.worlds.world import footholds_of, nominal_world
from climbplan.errors import UsageError
from climbplan.mechanics.stiffness import joint_softness, limb_compliance
from climbplan.robots.chain_pose import RADIAN
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.kinematics import contact_points, jacobian_world, toe_world
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.simulation.conditions import Conditions, regulated
from climbplan.simulation.motors import (
    believed_stiffness,
    joint_damping,
    motor_stiffness,
    plays,
    rotor_inertia,
)
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import Region, Tube

SPAN = 0.25  # [s] of a step at most, simulated time
_SPAN_LATE = 0.1  # [s] with a regulator that is late
_NOT_KNOWN = "the statics engine does not know: --engine mujoco"
_DRAWS = 4096  # errors of sensors that are drawn for a run
_REGULATORS = {
    "nothing": NO_REGULATOR, "attitude": BY_ATTITUDE, "joints": BY_JOINTS, "pose": BY_POSE
}  # fmt: skip


@dataclass(frozen=True)
class Steps:
    """A plan prepared for the compiled run."""

    playback: Playback
    sample: IntArray  # (S,) of the trajectory that each step ends at
    instant: IntArray  # (S,) planned instant it belongs to, -1 before the first


def prepare(plan: ClimbPlan, conditions: Conditions) -> Steps:
    """The steps of a plan, the same for all worlds under these conditions.

    Raises UsageError for robots with grippers, flat feet, five-bar legs or limbs of fewer than
    three joints.
    """
    robot, moving = plan.robot, plan.trajectory
    zero, unit = _zero(plan), robot.joint_unit
    sample = _samples(plan, conditions.speed, _SPAN_LATE if conditions.delay > 0 else SPAN)
    instant = sample_instants(plan)
    angles = true_angles(plan, instant)
    weight = -limb_weight_torques(plan, conditions)
    carrying = np.zeros_like(moving.joint_command)
    if conditions.limb_weights:
        carrying = -weight / believed_stiffness(robot, conditions)
    command = moving.joint_command + carrying
    wrench = plan.instants.external_wrench[np.maximum(instant, 0)] + limb_weight_wrench(
        plan, conditions
    )
    jacobian = jacobian_world(robot, moving.rpy[sample], angles[sample])
    turning = turning_of(jacobian)
    most = joint_softness(robot) * robot.max_torque
    bent = np.clip((angles - moving.joint_command)[sample], -most, most)
    toes = toe_world(robot, moving.com[sample], moving.rpy[sample], angles[sample])
    arm = toes - moving.com[sample][:, None]
    trusted = standing(plan)[sample]
    holds = footholds_of(moving.contact)
    pressing = held_toes(plan) & (planned_pressure(plan) >= LEAST_HELD)
    span = np.diff(moving.time[sample], prepend=moving.time[0]) / conditions.speed
    c = np.ascontiguousarray
    playback = Playback(
        zero=zero,
        ends=contact_ends(plan, sample, angles, zero[:, 2 * robot.joint_count]),
        span=span,
        command=c(command[sample] / unit),
        weight=c(weight[sample] * unit),
        carrying=c(carrying[sample] / unit),
        wrench=c(wrench[sample]),
        com=c(moving.com[sample]),
        rotation=c(rotation_world_body(moving.rpy[sample])),
        stands=c(pressing[sample].astype(np.int64)),
        trusted=c(trusted.astype(np.int64)),
        contact=c(moving.contact[sample].astype(np.int64)),
        settled=c((trusted == moving.contact[sample]).all(axis=1).astype(np.int64)),
        turning=c(turning / unit[..., None]),
        arm=c(arm),
        jacobian=c(jacobian * unit[:, None]),
        bent=c(bent / unit),
        sharing=c(between_toes(limb_compliance(robot, jacobian), arm, moving.contact[sample])),
        most=c(most / unit),
        foothold=c(holds.number[sample]),
        share=c(holds.share[sample]),
        toes=contact_points(robot, plan.rounds.toes[0], plan.instants.normal[0]),
    )
    return Steps(playback, sample, instant[sample])


def played(
    plan: ClimbPlan, steps: Steps, conditions: Conditions, path: Array | None = None
) -> Array:
    """(COLUMNS,) what becomes of a plan under conditions, in their world.

    path: of `play`.
    """
    terrain = moved_terrain(plan.terrain, conditions.world or nominal_world(plan))
    machine = machine_of(plan, terrain, steps, conditions)
    ground = ground_of(plan, terrain, conditions)
    if path is None:
        path = np.zeros((0, 3 + 6 * plan.robot.limb_count))
    plays = steps.playback._replace(zero=_first_zero(steps.playback))  # which the run changes
    return play(plays, machine, ground, path)


def _first_zero(playback: Playback) -> Array:
    """A copy of the limbs at zero angles as the first step has them."""
    zero = playback.zero.copy()
    if len(playback.ends):
        zero[:, 2 * playback.command.shape[2]] = playback.ends[0]
    return zero


def machine_of(plan: ClimbPlan, terrain: Terrain, steps: Steps, conditions: Conditions) -> Machine:
    """The robot under conditions, in their world, set up on its terrain."""
    robot, world = plan.robot, conditions.world or nominal_world(plan)
    mass = robot.mass * world.mass + conditions.payload
    half = np.abs(robot.body_hull).max(axis=0)
    unit = robot.joint_unit
    stiffness = motor_stiffness(robot, conditions) * unit**2
    start = set_up(plan, terrain)
    toes = start.toes
    if robot.foot is not None:
        on = [terrain.surfaces[r] for r in plan.rounds.region[0]]
        toes = toes + robot.foot.arm(
            np.array([s.normal_at(toe) for s, toe in zip(on, toes, strict=True)])
        )
    times = plan.trajectory.time[steps.sample]
    losses = [
        (x.limb, *np.searchsorted(times, [x.start, x.start + x.duration]))
        for x in conditions.losses
    ]
    return Machine(
        mass=float(mass),
        inertia=float(mass * 2 * (half**2).sum() / 9),  # mean of a box's three
        gravity=float(robot.gravity),
        offset=world.com.copy(),
        stiffness=np.ascontiguousarray(stiffness),
        damping=np.ascontiguousarray(joint_damping(robot, conditions) * unit**2),
        armature=np.ascontiguousarray(rotor_inertia(robot, conditions) * unit**2),
        play=plays(robot, conditions) / unit,
        strongest=np.ascontiguousarray(robot.max_torque * unit),
        placement=np.ascontiguousarray(world.placement),
        losses=np.array(losses, float).reshape(-1, 3),
        toes=np.ascontiguousarray(toes),
        angles=np.ascontiguousarray(start.angles / unit),
        regulator=_REGULATORS[regulated(conditions, plan.robot)],
        delay=conditions.delay,
        noise=_noise(robot.limb_count, robot.joint_count, conditions),
    )


def _noise(limbs: int, joints: int, conditions: Conditions) -> Array:
    """(D, N, J) errors of the joints' sensors [rad], which a run takes in turn; D = 0 of none."""
    size = _DRAWS if conditions.joint_noise > 0 else 0
    rng = np.random.default_rng(conditions.noise_seed)
    return rng.normal(0.0, conditions.joint_noise, (size, limbs, joints))


def ground_of(plan: ClimbPlan, terrain: Terrain, conditions: Conditions) -> Ground:
    """The terrain of a world under conditions."""
    flat = [s for s in terrain.surfaces if isinstance(s, Region)]
    round_ones = [s for s in terrain.surfaces if isinstance(s, Tube)]
    friction = [region.friction for region in flat]
    friction += [float(np.min(plan.instants.mu))] * len(terrain.obstacles)
    tubes = [(*t.center, t.radius + t.standoff, t.lower, t.upper) for t in round_ones]
    # Toes of feet are where these touch; points have a small radius, as MuJoCo's have
    radius = TOE_RADIUS if plan.robot.foot is None else 0.0
    return Ground(
        solids=material(terrain, radius),
        friction=np.array(friction, float) * conditions.friction,
        tubes=np.array(tubes, float).reshape(-1, 5),
        tube_friction=np.array([t.friction for t in round_ones], float) * conditions.friction,
    )


def _samples(plan: ClimbPlan, speed: float, most: float) -> IntArray:
    """Samples at which steps end: so long apart at most [s], both sides of changes of contact."""
    time = plan.trajectory.time
    states = np.hstack([plan.trajectory.contact, standing(plan)])
    change = np.flatnonzero((states[1:] != states[:-1]).any(axis=1))
    forced = np.unique(np.concatenate([[0, len(time) - 1], *(change + k for k in range(4))]))
    forced = forced[forced < len(time)]
    found = [forced[:1]]
    for first, last in pairwise(forced.tolist()):
        pieces = max(1, int(np.ceil((time[last] - time[first]) / speed / most - 1e-9)))
        pieces = min(pieces, int(last - first))
        found.append(np.rint(np.linspace(first, last, pieces + 1)[1:]).astype(np.int64))
    return np.concatenate(found)


def _zero(plan: ClimbPlan) -> Array:
    """(N, 2J + 1, 3) axes, joints and toes at zero angles, and directions of joints that slide.

    Lengths of these are counted in `RADIAN`, here as in all that is played.
    """
    robot = plan.robot
    if robot.gripper is not None:
        raise UsageError(f"{plan.name}: {robot.name} has grippers, which {_NOT_KNOWN}")
    if isinstance(robot.mechanism, FiveBar):
        raise UsageError(f"{plan.name}: {robot.name} has five-bar legs, which {_NOT_KNOWN}")
    if robot.joint_count < 3:
        raise UsageError(
            f"{plan.name}: limbs of {robot.name} have fewer than three joints, which {_NOT_KNOWN}"
        )
    if robot.sole is not None:
        raise UsageError(f"{plan.name}: {robot.name} has flat feet, which {_NOT_KNOWN}")
    if isinstance(robot.mechanism, SerialChain) and robot.mechanism.drive is not None:
        raise UsageError(
            f"{plan.name}: limbs of {robot.name} have joints that mimic others, which {_NOT_KNOWN}"
        )
    if not robot.has_joint.all():
        raise UsageError(
            f"{plan.name}: limbs of {robot.name} have unlike numbers of joints, which {_NOT_KNOWN}"
        )
    zero = zero_angles(robot)
    assert zero is not None
    rows = [zero.axes, zero.joints, zero.toe[:, None]]
    if zero.slides is not None:
        rows.append(RADIAN * zero.slides)
    return np.concatenate(rows, axis=1).copy()
