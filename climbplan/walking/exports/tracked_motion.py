"""The motion of a walk for motion-tracking pipelines: links of a URDF robot, exact contacts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.exports.motion import RobotMotion
from climbplan.motions.link_tree import JointFill, build_joint_fill, build_link_tree
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
from climbplan.walking.exports.motion import WalkSampler, read_motion
from climbplan.walking.plan.foot_centres import restore_surface


def read_tracked_motion(path: Path, rate: float | None) -> TrackedMotion:
    """Read a walk of a URDF robot as a motion at a fixed rate.

    Stance toes are where the plan has them at every time, and joints follow by inverse kinematics.

    Args:
        path: The plan file.
        rate: Sample rate [Hz]; None takes 50 Hz.

    Raises:
        PlanFileError: It is no walk or damaged.
        UsageError: The rate is out of range, or the plan has no joints.
    """
    walk = read_motion(path)
    sampler = walk.sampler
    assert isinstance(sampler, WalkSampler)
    if sampler.joints is None or walk.joints is None:
        raise UsageError(f"{path}: links are not exported: {'; '.join(walk.words)}")
    urdf = sampler.joints.model.robot
    tree = build_link_tree(urdf.tree)
    links = _WalkLinks(sampler, build_joint_fill(urdf.tree, tree, urdf.spec.locked_positions))
    begin, end = float(walk.time[0]), float(walk.time[-1])
    time, fps = build_times(begin, end, rate)
    arrays = differentiate_links(links.evaluate, time, begin, end)
    motion = sampler(time)
    assert motion.joints is not None
    plan = sampler.plan
    ground = plan.task.ground
    return TrackedMotion(
        name=plan.name,
        fps=fps,
        joint_names=tree.joint_names,
        body_names=tree.link_names,
        **vars(arrays),
        joint_command=links.fill.fill_positions(motion.joints.names, motion.joints.command),
        joint_torque=links.fill.fill_torques(
            motion.joints.names, motion.joints.torque + motion.joints.gravity
        ),
        bounds=tree.bounds,
        contacts=_build_contacts(links, motion),
        surfaces=Surfaces(ground.names, ground.find_friction(np.arange(ground.count))),
        terrain=_build_terrain_mesh(sampler, motion),
        facts={
            "robot": plan.task.body.name,
            "spec_sha256": plan.spec_sha256,
            "climbplan_version": plan.climbplan_version,
            "mass": plan.task.body.mass,
        },
        notes=motion.words,
    )


@dataclass(frozen=True)
class _WalkLinks:
    """The links of a walking robot as functions of time."""

    sampler: WalkSampler
    fill: JointFill

    def evaluate(self, time: Array) -> LinkStates:
        """Return joints and links at times (M,) [s]."""
        motion = self.sampler(time)
        assert motion.joints is not None
        assert motion.base is not None
        joints = self.fill.fill_positions(motion.joints.names, motion.joints.angle)
        rotation = Rotation.from_quat(motion.base.quaternion).as_matrix()
        poses = self.fill.tree.compute_poses(motion.base.position, rotation, joints)
        return LinkStates(joints, poses.position, poses.rotation)


def _build_contacts(links: _WalkLinks, motion: RobotMotion) -> ContactSamples:
    """Return contacts at the samples of a motion, with toes in the frames of their links."""
    plan, contacts = links.sampler.plan, motion.contacts
    assert contacts is not None
    assert links.sampler.joints is not None
    spec, ground = links.sampler.joints.model.robot.spec, plan.task.ground
    region = plan.trajectory.gait.region[links.sampler.find_intervals(motion.time)]
    touching = contacts.touching
    toes = [spec.legs[name] for name in contacts.names]
    return ContactSamples(
        names=contacts.names,
        body=np.array([links.fill.tree.find_link(leg.toe) for leg in toes]),
        offset=np.array([leg.toe_offset for leg in toes], float)[:, None],
        radius=np.full(len(toes), ground.standoff),
        is_touching=touching,
        surface=np.where(touching, region, -1),
        force=contacts.force,
        position=contacts.point,
        normal=np.where(touching[..., None], ground.frame[region][..., 2, :], 0.0),
    )


def _build_terrain_mesh(sampler: WalkSampler, motion: RobotMotion) -> TerrainMesh:
    """Return the footholds as polygons, or the triangles of a scan in which they were found."""
    scan = restore_surface(sampler.plan.task.ground).scan
    if scan is not None:
        return TerrainMesh(scan.vertices, scan.triangles)
    surfaces = motion.facts["surfaces"]
    assert isinstance(surfaces, list)
    return build_polygon_mesh([np.array(surface["corners"]) for surface in surfaces])
