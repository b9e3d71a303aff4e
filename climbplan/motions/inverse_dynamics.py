"""Joint torques and unbalanced forces of a motion, by Newton and Euler's equations of its links.

With mass m_i, centre of mass c_i and angular momentum L_i of link i about it, contact forces f_k
and moments m_k at x_k, and a joint of axis z at p that carries the links S and the contacts K,

    tau = z . ( sum_S ((c_i - p) x m_i (a_i - g) + dL_i/dt) - sum_K ((x_k - p) x f_k + m_k) ),

and the force that nothing accounts for is sum_i m_i (a_i - g) - sum_k f_k. Accelerations are
central differences of the stored velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.motions.link_tree import LinkTree, build_joint_fill
from climbplan.motions.tracked_motion import TrackedMotion
from climbplan.schema.robots.urdf.tree import UrdfTree
from climbplan.schema.robots.xml import (
    Element,
    parse_xml,
    read_number_attribute,
    read_vector_attribute,
)

_GRAVITY = np.array([0.0, 0.0, -9.81])  # [m/s^2]


@dataclass(frozen=True)
class LinkInertias:
    """Masses of B links, each in the frame of its link."""

    mass: Array  # (B,) [kg]
    centre: Array  # (B, 3) of mass [m]
    inertia: Array  # (B, 3, 3) about it [kg m^2]


@dataclass(frozen=True)
class MotionDynamics:
    """What the links' motion and the contact forces ask of the joints, at T - 2 inner samples."""

    torque: Array  # (T - 2, J) [N m], [N] of sliding joints; zero of joints that follow others
    unbalanced_force: Array  # (T - 2, 3) [N]
    unbalanced_moment: Array  # (T - 2, 3) about the origin of the root link [N m]
    weight: float  # [N]


def read_link_inertias(urdf: UrdfTree, robot: LinkTree) -> LinkInertias:
    """Return the masses of a URDF's links; links without an inertial element weigh nothing.

    Raises:
        UsageError: The robot weighs nothing.
    """
    links = {e.attributes.get("name", ""): e for e in parse_xml(urdf.text).all("link")}
    count = len(robot.link_names)
    out = LinkInertias(np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3)))
    for index, name in enumerate(robot.link_names):
        inertial = links[name].first("inertial")
        if inertial is not None:
            out.mass[index] = read_number_attribute(inertial.first("mass"), "value") or 0.0
            out.centre[index], out.inertia[index] = _read_inertia(inertial)
    if not out.mass.sum() > 0:
        raise UsageError(f"{urdf.path.name}: its links weigh nothing; expected masses")
    return out


def _read_inertia(inertial: Element) -> tuple[Array, Array]:
    """Return centre of mass (3,) and inertia about it (3, 3) in the frame of the link."""
    origin, inertia = inertial.first("origin"), inertial.first("inertia")
    centre, angles = np.zeros(3), np.zeros(3)
    if origin is not None:
        centre = np.array(read_vector_attribute(origin, "xyz") or centre)
        angles = np.array(read_vector_attribute(origin, "rpy") or angles)
    entry = {
        name: read_number_attribute(inertia, f"i{name}") or 0.0
        for name in ("xx", "xy", "xz", "yy", "yz", "zz")
    }
    matrix = np.array([[entry["".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])
    rotation = Rotation.from_euler("xyz", angles).as_matrix()
    return centre, rotation @ matrix @ rotation.T


def compute_dynamics(motion: TrackedMotion, urdf: UrdfTree, robot: LinkTree) -> MotionDynamics:
    """Return joint torques and unbalanced forces of a motion with contact forces.

    Args:
        motion: A motion of all links and joints of the robot, by name, with contact forces.
        urdf: The robot's file.
        robot: Its links.

    Raises:
        UsageError: The robot weighs nothing.
    """
    assert motion.contacts is not None
    assert motion.contacts.force is not None
    links = read_link_inertias(urdf, robot)
    bodies = [motion.body_names.index(name) for name in robot.link_names]
    rotation = motion.body_rotation[:, bodies]
    arm = (rotation @ links.centre[..., None])[..., 0]
    centre = motion.body_position[:, bodies] + arm
    spin = motion.body_angular_velocity[:, bodies]
    velocity = motion.body_velocity[:, bodies] + np.cross(spin, arm)
    momentum = (rotation @ links.inertia @ np.swapaxes(rotation, -1, -2) @ spin[..., None])[..., 0]
    rate = motion.fps / 2
    acceleration = (velocity[2:] - velocity[:-2]) * rate
    force = links.mass[:, None] * (acceleration - _GRAVITY)  # (T - 2, B, 3) on each link
    moment = np.cross(centre[1:-1], force) + (momentum[2:] - momentum[:-2]) * rate  # about 0
    contact_force = motion.contacts.force[1:-1]
    contact_moment = np.cross(motion.contacts.position[1:-1], contact_force)
    if motion.contacts.moment is not None:
        contact_moment = contact_moment + motion.contacts.moment[1:-1]
    for contact, body in enumerate(motion.contacts.body.tolist()):
        link = robot.find_link(motion.body_names[body])
        force[:, link] -= contact_force[:, contact]
        moment[:, link] -= contact_moment[:, contact]
    for link in range(len(robot.link_names) - 1, 0, -1):  # from the tips to the root
        force[:, robot.parent[link]] += force[:, link]
        moment[:, robot.parent[link]] += moment[:, link]
    torque = np.zeros((len(force), len(robot.joint_names)))
    for link in np.flatnonzero(robot.joint_of_link >= 0).tolist():
        joint = robot.joint_of_link[link]
        axis = (rotation[1:-1, link] @ robot.axis[link][:, None])[..., 0]
        place = motion.body_position[1:-1, bodies[link]]
        wrench = (
            force[:, link]
            if robot.slides[joint]
            else moment[:, link] - np.cross(place, force[:, link])
        )
        torque[:, joint] = (axis * wrench).sum(axis=-1)
    for name, (leader, ratio, _) in build_joint_fill(urdf, robot).followers.items():
        follower = robot.joint_names.index(name)
        torque[:, robot.joint_names.index(leader)] += ratio * torque[:, follower]
        torque[:, follower] = 0.0
    weight = float(links.mass.sum() * np.linalg.norm(_GRAVITY))
    root = motion.body_position[1:-1, bodies[0]]
    return MotionDynamics(torque, force[:, 0], moment[:, 0] - np.cross(root, force[:, 0]), weight)
