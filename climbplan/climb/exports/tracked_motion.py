"""The motion of a climb or transition for motion-tracking pipelines, with exact contacts.

Between the plan's samples the body moves on monotone cubic curves, which stand still where the
samples do. Joints of limbs in contact follow from the footholds by inverse kinematics at every
time, so that a toe in contact does not move at any rate. Joints of limbs in the air move on the
same curves as the body. Forces and torques are linear between samples, so that forces stay in their
friction cones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial import ConvexHull

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.exports.motion import build_motion, read_plan_urdf, solve_contact_wrench
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.plan.played import compute_true_angles, sample_instants
from climbplan.errors import ClimbplanError, UsageError
from climbplan.exports.base_link import BaseLink, build_base_link
from climbplan.exports.motion import RobotMotion, require_increasing
from climbplan.motions.link_tree import (
    JointBounds,
    JointFill,
    LinkTree,
    build_joint_fill,
    build_link_tree,
)
from climbplan.motions.tracked_motion import (
    ContactSamples,
    LinkStates,
    Surfaces,
    TerrainMesh,
    TrackedMotion,
    build_polygon_mesh,
    build_times,
    differentiate_links,
)
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.kinematics import joint_points_body, standing_inverse, toe_world
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.schema.robots.stored import NotKept
from climbplan.terrain.model import STATED, Terrain
from climbplan.terrain.surfaces import Region, Tube

_NUM_STAVES = 180  # flat pieces of a tube
_MIN_LENGTH = 1e-9  # [m] a shorter link has no direction

LinkFrames = Callable[[Array, Array, Array], LinkStates]  # of body position, rotation and angles


def read_tracked_motion(path: Path, rate: float | None) -> TrackedMotion:
    """Read a climb or transition plan as a motion at a fixed rate.

    Args:
        path: The plan file.
        rate: Sample rate [Hz]; None takes 50 Hz.

    Raises:
        PlanFileError: It is no climb or damaged.
        UsageError: The rate is out of range, or the links of the robot are unknown.
    """
    return build_tracked_motion(read_climb(path), rate)


def build_tracked_motion(plan: ClimbPlan, rate: float | None) -> TrackedMotion:
    """Return the motion of a plan; as `read_tracked_motion`."""
    require_increasing(plan.trajectory.time)
    robot_links = _build_robot_links(plan)
    sampler = _ClimbSampler(plan, robot_links.frames)
    begin, end = float(plan.trajectory.time[0]), float(plan.trajectory.time[-1])
    time, fps = build_times(begin, end, rate)
    links = differentiate_links(sampler.evaluate, time, begin, end)
    loads = build_motion(plan)
    assert loads.joints is not None
    torque = sampler.interpolate(loads.joints.torque + loads.joints.gravity, time)
    command = PchipInterpolator(plan.trajectory.time, loads.joints.command, axis=0)(time)
    names = plan.robot.motor_names
    return TrackedMotion(
        name=plan.name,
        fps=fps,
        joint_names=robot_links.joint_names,
        body_names=robot_links.body_names,
        **vars(links),
        joint_command=robot_links.fill_positions(names, command),
        joint_torque=robot_links.fill_torques(names, torque),
        bounds=robot_links.bounds,
        contacts=_build_contacts(sampler, robot_links, loads, time),
        surfaces=Surfaces(
            tuple(surface.name for surface in plan.terrain.surfaces),
            np.array([surface.friction for surface in plan.terrain.surfaces]),
        ),
        terrain=build_terrain_mesh(plan.terrain),
        facts={
            "robot": plan.robot.name,
            "spec_sha256": plan.spec_sha256,
            "climbplan_version": plan.climbplan_version,
            "mass": plan.robot.mass,
        },
        notes=sampler.describe_misses(),
    )


@dataclass(frozen=True)
class _ClimbSampler:
    """A climb as a function of time."""

    plan: ClimbPlan
    frames: LinkFrames

    @cached_property
    def _instant(self) -> IntArray:
        """(T,) of the plan's samples."""
        return sample_instants(self.plan)

    @cached_property
    def _footholds(self) -> Array:
        """(K + 1, N, 3) where limbs stand, before the first lift and at each instant [m]."""
        return np.concatenate([self.plan.rounds.toes[:1], self.plan.instants.toes])

    @cached_property
    def _is_standing(self) -> BoolArray:
        """(K + 1, N) likewise, limbs that stand on these footholds."""
        everyone = np.ones((1, self.plan.robot.limb_count), bool)
        return np.concatenate([everyone, self.plan.instants.contact])

    @cached_property
    def _normals(self) -> Array:
        """(K + 1, N, 3) of the surfaces there."""
        return np.concatenate([self.plan.instants.normal[:1], self.plan.instants.normal])

    @cached_property
    def _pose(self) -> PchipInterpolator:
        trajectory = self.plan.trajectory
        pose = np.hstack([trajectory.com, trajectory.rpy])
        return PchipInterpolator(trajectory.time, pose, axis=0)

    @cached_property
    def _angles(self) -> PchipInterpolator:
        angles = compute_true_angles(self.plan, self._instant)
        return PchipInterpolator(self.plan.trajectory.time, angles, axis=0)

    def find_samples(self, time: Array) -> IntArray:
        """Return the plan's sample (M,) at or before each time."""
        before = np.searchsorted(self.plan.trajectory.time, time + 1e-9, side="right") - 1
        return np.clip(before, 0, len(self.plan.trajectory.time) - 1)

    def interpolate(self, values: Array, time: Array) -> Array:
        """Return values (T, ...) of the plan's samples at times (M,), linear in between."""
        times = self.plan.trajectory.time
        before = np.clip(self.find_samples(time), 0, len(times) - 2)
        fraction = (time - times[before]) / (times[before + 1] - times[before])
        fraction = np.clip(fraction, 0, 1).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1 - fraction) * values[before] + fraction * values[before + 1])

    def compute_pose(self, time: Array) -> tuple[Array, Array]:
        """Return position and roll, pitch, yaw of the body (M, 3) [m, rad]."""
        pose = self._pose(time)
        return pose[:, :3], pose[:, 3:]

    def compute_angles(self, time: Array) -> tuple[Array, BoolArray]:
        """Return joint angles (M, N, J), and whether standing limbs miss their foothold (M, N)."""
        sample = self.find_samples(time)
        row = self._instant[sample] + 1
        com, rpy = self.compute_pose(time)
        solution = standing_inverse(
            self.plan.robot, com, rpy, self._footholds[row], self._normals[row]
        )
        is_standing = self.plan.trajectory.contact[sample] & self._is_standing[row]
        angles = np.where(
            (is_standing & solution.valid)[..., None], solution.best(), self._angles(time)
        )
        return angles, is_standing & ~solution.valid

    def evaluate(self, time: Array) -> LinkStates:
        """Return joints and links at times (M,) [s]."""
        com, rpy = self.compute_pose(time)
        return self.frames(com, rotation_world_body(rpy), self.compute_angles(time)[0])

    def describe_misses(self) -> tuple[str, ...]:
        """Return a note where standing limbs do not reach their footholds."""
        missed = int(self.compute_angles(self.plan.trajectory.time)[1].any(axis=1).sum())
        if not missed:
            return ()
        return (f"standing limbs do not reach their footholds at {missed} samples of the plan",)

    def find_contacts(self, time: Array) -> tuple[BoolArray, Array, IntArray]:
        """Return contacts (M, N), normals (M, N, 3) and surfaces (M, N); zero, -1 in the air."""
        sample = self.find_samples(time)
        row = self._instant[sample] + 1
        touching = self.plan.trajectory.contact[sample]
        region = np.concatenate([self.plan.rounds.region[:1], self.plan.instants.region])[row]
        return (
            touching,
            np.where(touching[..., None], self._normals[row], 0.0),
            np.where(touching, region, -1),
        )


@dataclass(frozen=True)
class _RobotLinks:
    """Names, frames and limits of a robot's links and joints."""

    body_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    toe_bodies: IntArray  # (N,) link that carries each toe
    bounds: JointBounds
    frames: LinkFrames
    fill: JointFill | None = None  # of the joints of a URDF; None: limbs have them all

    def fill_positions(self, names: tuple[str, ...], values: Array) -> Array:
        """Return positions of all joints for those (T, M) of motors."""
        return values if self.fill is None else self.fill.fill_positions(names, values)

    def fill_torques(self, names: tuple[str, ...], values: Array) -> Array:
        """Return torques of all joints for those (T, M) of motors."""
        return values if self.fill is None else self.fill.fill_torques(names, values)


def _build_robot_links(plan: ClimbPlan) -> _RobotLinks:
    """Return the links of a plan's robot, from its URDF where it is from one.

    Raises:
        UsageError: The URDF is not kept, or is not that of the plan.
    """
    try:
        urdf = read_plan_urdf(plan)
        if urdf is None:
            return _build_limb_links(plan.robot)
        tree = build_link_tree(urdf.tree)
        fill = build_joint_fill(urdf.tree, tree, urdf.spec.locked_positions)
        chain = plan.robot.mechanism
        assert isinstance(chain, SerialChain)
        base = build_base_link(urdf, chain, np.eye(3))
    except (NotKept, ClimbplanError, ValueError) as reason:
        raise UsageError(
            f"{plan.name}: links are not exported: {str(reason).splitlines()[0]}"
        ) from reason
    toe_bodies = [tree.find_link(urdf.spec.legs[name].toe) for name in plan.robot.limb_names]
    return _RobotLinks(
        tree.link_names,
        tree.joint_names,
        np.array(toe_bodies),
        _restrict_bounds(tree, plan.robot),
        _build_urdf_frames(plan.robot, tree, fill, base),
        fill,
    )


def _restrict_bounds(tree: LinkTree, robot: Robot) -> JointBounds:
    """Return the limits of a URDF's joints, of motors those that the plan has."""
    planned = _list_bounds(robot)
    out = replace(
        tree.bounds, **{name: values.copy() for name, values in vars(tree.bounds).items()}
    )
    for motor, joint_name in enumerate(robot.motor_names):
        joint = tree.joint_names.index(joint_name)
        for name, values in vars(out).items():
            values[joint] = getattr(planned, name)[motor]
    return out


def _list_bounds(robot: Robot) -> JointBounds:
    has_joint = robot.has_joint
    return JointBounds(
        robot.joint_lower[has_joint],
        robot.joint_upper[has_joint],
        robot.max_joint_speed[has_joint],
        robot.max_torque[has_joint],
    )


def _build_urdf_frames(robot: Robot, tree: LinkTree, fill: JointFill, base: BaseLink) -> LinkFrames:
    """Return the function that places the links of a URDF."""

    def place(com: Array, rotation: Array, angles: Array) -> LinkStates:
        joints = fill.fill_positions(robot.motor_names, angles[:, robot.has_joint])
        poses = tree.compute_poses(com + rotation @ base.position, rotation @ base.rotation, joints)
        return LinkStates(joints, poses.position, poses.rotation)

    return place


def _build_limb_links(robot: Robot) -> _RobotLinks:
    """Return the body and the links of limbs of a robot file, which has no URDF.

    A link's frame is at its joint, with x along the link and y normal to the plane of the limb.
    """
    if robot.gripper is None and isinstance(robot.mechanism, SerialChain):
        raise UsageError(f"{robot.name}: its links are those of a URDF, which the plan lacks")
    link_names = [
        tuple(
            "last_link" if j == len(names) - 1 and _is_linkage(robot) else name
            for j, name in enumerate(names)
        )
        for names in robot.limbs.joint_names
    ]
    bodies = [
        f"{limb}_{link}"
        for limb, names in zip(robot.limb_names, link_names, strict=True)
        for link in names
    ]
    toes = np.cumsum([len(names) for names in link_names])

    def place(com: Array, rotation: Array, angles: Array) -> LinkStates:
        points = joint_points_body(robot, angles)  # (M, N, P, 3)
        along = np.diff(points, axis=-2)
        length = np.linalg.norm(along, axis=-1, keepdims=True)
        hinge = robot.limbs.last_link(angles)[..., 2, :][..., None, :]
        x = along / np.maximum(length, _MIN_LENGTH)
        y = np.broadcast_to(hinge, x.shape)
        frames = np.stack([x, y, np.cross(x, y)], axis=-1)  # (M, N, links, 3, 3)
        count = len(com)
        position = points[..., :-1, :].reshape(count, -1, 3)
        world_frames = rotation[:, None] @ frames.reshape(count, -1, 3, 3)
        return LinkStates(
            angles[:, robot.has_joint],
            np.concatenate(
                [com[:, None], com[:, None] + position @ np.swapaxes(rotation, -1, -2)], axis=1
            ),
            np.concatenate([rotation[:, None], world_frames], axis=1),
        )

    return _RobotLinks(("body", *bodies), robot.motor_names, toes, _list_bounds(robot), place)


def _is_linkage(robot: Robot) -> bool:
    """Return whether the last link of a limb moves with no joint alone, but with all of them."""
    return isinstance(robot.mechanism, FiveBar)


def _build_contacts(
    sampler: _ClimbSampler, links: _RobotLinks, loads: RobotMotion, time: Array
) -> ContactSamples:
    """Return contacts at times, with the points of feet in the frames of their links."""
    plan, robot = sampler.plan, sampler.plan.robot
    assert loads.contacts is not None
    touching, normal, surface = sampler.find_contacts(time)
    com, rpy = sampler.compute_pose(time)
    toes = toe_world(robot, com, rpy, sampler.compute_angles(time)[0])
    force = sampler.interpolate(loads.contacts.force, time)
    return ContactSamples(
        names=robot.limb_names,
        body=links.toe_bodies,
        offset=_locate_foot_points(sampler, links),
        radius=np.full(robot.limb_count, robot.standoff),
        is_touching=touching,
        surface=surface,
        force=np.where(touching[..., None], force, 0.0),
        moment=_build_sole_moments(sampler, loads, time, touching),
        position=toes - robot.standoff * normal,
        normal=normal,
        is_gripping=plan.robot.gripper is not None,
    )


def _build_sole_moments(
    sampler: _ClimbSampler, loads: RobotMotion, time: Array, touching: BoolArray
) -> Array | None:
    """Return moments (M, N, 3) of the terrain on flat feet about their toes; None for others."""
    plan, robot = sampler.plan, sampler.plan.robot
    if robot.sole is None:
        return None
    if plan.trajectory.moment is not None:
        moment = sampler.interpolate(plan.trajectory.moment, time)
        return np.where(touching[..., None], moment, 0.0)
    assert loads.joints is not None
    torque = np.zeros((len(plan.trajectory.time), *robot.has_joint.shape))
    torque[:, robot.has_joint] = loads.joints.torque
    angles = sampler.compute_angles(plan.trajectory.time)[0]
    moment = solve_contact_wrench(plan, angles, torque)[..., 3:]
    moment = np.where(plan.trajectory.contact[..., None], moment, 0.0)
    return np.where(touching[..., None], sampler.interpolate(moment, time), 0.0)


def _locate_foot_points(sampler: _ClimbSampler, links: _RobotLinks) -> Array:
    """Return the points (N, K, 3) of feet in the frames of their links: toes, corners of soles."""
    robot, trajectory = sampler.plan.robot, sampler.plan.trajectory
    time = trajectory.time[:1]
    normal = sampler.find_contacts(time)[1]
    com, rpy = sampler.compute_pose(time)
    points = toe_world(robot, com, rpy, sampler.compute_angles(time)[0])[..., None, :]
    if robot.sole is not None:
        points = points + robot.sole.arms(normal)
    state = sampler.evaluate(time)
    position = state.body_position[0, links.toe_bodies]
    rotation = state.body_rotation[0, links.toe_bodies]
    return np.asarray((points[0] - position[:, None]) @ rotation)


def build_terrain_mesh(terrain: Terrain) -> TerrainMesh:
    """Return the surfaces and obstacles of a terrain, and the triangles of its scan, as one mesh.

    Regions that were found in a scan are left out: the scan's own triangles stand for them.
    """
    polygons: list[Array] = []
    for surface in terrain.surfaces:
        if isinstance(surface, Tube):
            polygons += _list_staves(surface)
        elif isinstance(surface, Region) and (terrain.scan is None or surface.name in STATED):
            polygons.append(surface.material)
    meshes = [_build_hull_mesh(solid.vertices) for solid in terrain.obstacles]
    if terrain.scan is not None:
        meshes.append(TerrainMesh(terrain.scan.vertices, terrain.scan.triangles))
    return build_polygon_mesh(polygons, *meshes)


def _build_hull_mesh(points: Array) -> TerrainMesh:
    """Return the faces of the hull of points (V, 3), facing outward."""
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces_inward = (normal * hull.equations[:, :3]).sum(axis=1) < 0
    return TerrainMesh(
        points, np.where(faces_inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    )


def _list_staves(tube: Tube) -> list[Array]:
    """Return flat pieces (4, 3) of a tube's wall, anticlockwise seen from its axis."""
    angle = np.linspace(0, 2 * np.pi, _NUM_STAVES + 1)
    ring = tube.center + tube.wall * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    low, high = (np.column_stack([ring, np.full(len(ring), z)]) for z in (tube.lower, tube.upper))
    return [np.stack([low[i + 1], low[i], high[i], high[i + 1]]) for i in range(_NUM_STAVES)]
