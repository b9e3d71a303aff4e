"""Forward kinematics of all links of a URDF, for many samples at once.

Links and joints are in depth-first order, children in the order of the file's joints. That is the
order of MuJoCo; Isaac Lab has them breadth first. Files carry the names, so that readers of either
order can select by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.schema.robots.urdf.mimics import resolve_mimic
from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree
from climbplan.schema.robots.xml import Element, parse_xml, read_vector_attribute


@dataclass(frozen=True)
class JointBounds:
    """Limits of J joints; infinite where the robot has none."""

    lower: Array  # (J,) [rad], [m] of sliding joints
    upper: Array  # (J,)
    speed: Array  # (J,) [rad/s]
    torque: Array  # (J,) [N m], [N] of sliding joints


@dataclass(frozen=True)
class LinkPoses:
    """B links at T samples, world frame."""

    position: Array  # (T, B, 3) of the links' frames [m]
    rotation: Array  # (T, B, 3, 3) link to world


@dataclass(frozen=True)
class LinkTree:
    """B links of a URDF below its root, and the J joints among them that move."""

    link_names: tuple[str, ...]  # (B,) depth first, the root first
    joint_names: tuple[str, ...]  # (J,) that turn or slide, in the order of their links
    parent: IntArray  # (B,) index of the link that carries each; -1 of the root
    origin: Array  # (B, 3) of each link's joint in the frame of its parent [m]
    origin_rotation: Array  # (B, 3, 3) of that joint's frame
    axis: Array  # (B, 3) unit, in the joint's frame; zero where it is fixed
    joint_of_link: IntArray  # (B,) index of the moving joint that carries the link, or -1
    slides: BoolArray  # (J,)
    bounds: JointBounds

    def compute_poses(
        self, root_position: Array, root_rotation: Array, joint_position: Array
    ) -> LinkPoses:
        """Return the poses of all links.

        Args:
            root_position: (T, 3) origin of the root link, world frame [m].
            root_rotation: (T, 3, 3) root link to world.
            joint_position: (T, J) [rad], [m] of sliding joints.
        """
        count = len(root_position)
        position = np.empty((count, len(self.link_names), 3))
        rotation = np.empty((count, len(self.link_names), 3, 3))
        position[:, 0], rotation[:, 0] = root_position, root_rotation
        for link in range(1, len(self.link_names)):
            parent, joint = self.parent[link], self.joint_of_link[link]
            base = rotation[:, parent] @ self.origin_rotation[link]
            start = position[:, parent] + rotation[:, parent] @ self.origin[link]
            if joint < 0:
                position[:, link], rotation[:, link] = start, base
                continue
            motion = joint_position[:, joint, None] * self.axis[link]
            if self.slides[joint]:
                position[:, link] = start + (base @ motion[..., None])[..., 0]
                rotation[:, link] = base
            else:
                position[:, link] = start
                rotation[:, link] = base @ Rotation.from_rotvec(motion).as_matrix()
        return LinkPoses(position, rotation)

    def find_link(self, name: str) -> int:
        """Return the index of a link; raises UsageError with the names that there are."""
        if name not in self.link_names:
            raise UsageError(
                f"the robot has no link {name!r}: expected one of {', '.join(self.link_names)}"
            )
        return self.link_names.index(name)


@dataclass(frozen=True)
class RobotFile:
    """A robot's URDF, and its links."""

    urdf: UrdfTree
    links: LinkTree


@dataclass(frozen=True)
class JointFill:
    """How all joints of a URDF follow from those that a plan moves."""

    tree: LinkTree
    held_positions: Mapping[str, float]  # positions of held joints by name [rad, m]
    followers: Mapping[str, tuple[str, float, float]]  # leader, ratio and offset by name

    def fill_positions(self, names: tuple[str, ...], values: Array) -> Array:
        """Return positions (T, J) of all joints for values (T, M) of named ones [rad, m].

        Joints that are neither named nor held nor followers are at zero, as in planning.
        """
        filled = np.zeros((len(values), len(self.tree.joint_names)))
        for name, position in self.held_positions.items():
            if name in self.tree.joint_names:
                filled[:, self.tree.joint_names.index(name)] = position
        columns = dict(zip(names, values.T, strict=True))
        for joint, name in enumerate(self.tree.joint_names):
            if name in columns:
                filled[:, joint] = columns[name]
        for name, (leader, ratio, offset) in self.followers.items():
            follower, index = (self.tree.joint_names.index(n) for n in (name, leader))
            filled[:, follower] = ratio * filled[:, index] + offset
        return filled

    def fill_torques(self, names: tuple[str, ...], values: Array) -> Array:
        """Return torques (T, J) for values (T, M) of named joints [N m]; NaN where none is known.

        A joint that follows another one has no motor, so its torque is zero.
        """
        filled = np.full((len(values), len(self.tree.joint_names)), np.nan)
        columns = dict(zip(names, values.T, strict=True))
        for joint, name in enumerate(self.tree.joint_names):
            if name in columns:
                filled[:, joint] = columns[name]
            elif name in self.followers:
                filled[:, joint] = 0.0
        return filled


def build_link_tree(urdf: UrdfTree) -> LinkTree:
    """Return the tree of all links of a URDF below its root.

    Raises:
        UsageError: It has several roots, or joints that neither turn, slide nor are fixed.
    """
    elements = {
        element.attributes.get("name", ""): element for element in parse_xml(urdf.text).all("joint")
    }
    if len(urdf.roots) != 1:
        raise UsageError(f"{urdf.path.name}: expected one root link, got {', '.join(urdf.roots)}")
    children: dict[str, list[str]] = {name: [] for name in urdf.links}
    for joint in urdf.joints.values():
        if not (joint.moves or joint.kind == "fixed"):
            raise UsageError(
                f"{urdf.path.name}: joint {joint.name!r} is {joint.kind}; expected joints that "
                "turn, slide or are fixed"
            )
        children[joint.parent].append(joint.name)
    links, parents = [urdf.roots[0]], [-1]
    joints: list[UrdfJoint] = []
    origins, rotations, axes, joint_of_link = [np.zeros(3)], [np.eye(3)], [np.zeros(3)], [-1]
    pending = [(0, name) for name in reversed(children[links[0]])]
    while pending:
        parent, name = pending.pop()
        joint, element = urdf.joints[name], elements[name]
        position, rotation = _read_origin(element)
        links.append(joint.child)
        parents.append(parent)
        origins.append(position)
        rotations.append(rotation)
        axes.append(_read_axis(element) if joint.moves else np.zeros(3))
        joint_of_link.append(len(joints) if joint.moves else -1)
        if joint.moves:
            joints.append(joint)
        pending += [(len(links) - 1, child) for child in reversed(children[joint.child])]
    return LinkTree(
        tuple(links),
        tuple(joint.name for joint in joints),
        np.array(parents),
        np.array(origins),
        np.array(rotations),
        np.array(axes),
        np.array(joint_of_link),
        np.array([joint.slides for joint in joints], bool),
        JointBounds(
            np.array([joint.lower for joint in joints], float),
            np.array([joint.upper for joint in joints], float),
            np.array([joint.velocity or np.inf for joint in joints], float),
            np.array([joint.effort or np.inf for joint in joints], float),
        ),
    )


def build_joint_fill(
    urdf: UrdfTree, tree: LinkTree, held_positions: Mapping[str, float] | None = None
) -> JointFill:
    """Return how joints that a plan does not move follow."""
    held_positions = held_positions or {}
    followers = {}
    for name in tree.joint_names:
        mimic = resolve_mimic(urdf, urdf.joints[name])
        if mimic is not None and name not in held_positions:
            followers[name] = (mimic.leader, mimic.ratio, mimic.offset)
    return JointFill(tree, held_positions, followers)


def _read_origin(element: Element) -> tuple[Array, Array]:
    """Return position (3,) [m] and rotation (3, 3) of a joint in the frame of its parent link."""
    origin = element.first("origin")
    if origin is None:
        return np.zeros(3), np.eye(3)
    position = read_vector_attribute(origin, "xyz") or (0.0, 0.0, 0.0)
    angles = read_vector_attribute(origin, "rpy") or (0.0, 0.0, 0.0)
    return np.array(position), np.asarray(Rotation.from_euler("xyz", angles).as_matrix())


def _read_axis(element: Element) -> Array:
    """Return the unit axis (3,) of a joint; along x where the file states none."""
    axis = element.first("axis")
    values = None if axis is None else read_vector_attribute(axis, "xyz")
    direction = np.array(values or (1.0, 0.0, 0.0))
    return np.asarray(direction / np.linalg.norm(direction))
