"""Detection of limbs in the kinematic tree of a URDF.

A limb is a chain of joints that carries no further limbs. From every joint on the body the chain
is followed outwards. Where it divides into several chains of at least three joints each, the
joints before are shared (a waist) and have to be locked. Where it divides into shorter ones
(fingers), the limb ends. Prismatic joints, joints that mimic others and joints that cannot move
(lower bound equal to upper) end a limb, too. Legs are the largest group of similar limbs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from climbplan.errors import UsageError
from climbplan.schema.robots.urdf.checks import FEWEST_JOINTS, MOST_JOINTS
from climbplan.schema.robots.urdf.model import FEWEST_LEGS
from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree

_MAX_LENGTH_DIFFERENCE = 0.2  # relative, within a group of limbs


@dataclass(frozen=True)
class LimbChain:
    """One limb, from the body outwards."""

    joints: tuple[UrdfJoint, ...]  # that move it, at most seven
    locked: tuple[UrdfJoint, ...]  # beyond its end

    @property
    def end(self) -> str:
        """The link that its last joint moves."""
        return self.joints[-1].child


@dataclass(frozen=True)
class LimbChains:
    """The limbs of a URDF, and the joints that several of them share."""

    limbs: tuple[LimbChain, ...]
    shared: tuple[UrdfJoint, ...]
    too_short: dict[str, int]  # number of joints of chains too short for a limb, by end link
    immovable: tuple[str, ...] = ()  # joints that end limbs, as their bounds leave no motion


def find_body_link(tree: UrdfTree) -> str:
    """Return the link that is the body: the root, or what a floating joint carries below it."""
    body = (tree.roots or [""])[0]
    for joint in tree.joints.values():
        if joint.kind == "floating" and joint.parent == body:
            return joint.child
    return body


def find_limbs(tree: UrdfTree, base: str) -> LimbChains:
    """Return all limbs of three joints or more that the base carries."""
    children_of: dict[str, list[UrdfJoint]] = {}
    for joint in tree.joints.values():
        children_of.setdefault(joint.parent, []).append(joint)

    def list_moving_joints(link: str) -> list[UrdfJoint]:
        """Return joints that move and are carried by the rigid body of a link."""
        joints = []
        for joint in children_of.get(link, []):
            joints += list_moving_joints(joint.child) if joint.kind == "fixed" else [joint]
        return joints

    shared: list[UrdfJoint] = []
    immovable: list[str] = []

    def follow_chains(joint: UrdfJoint) -> list[list[UrdfJoint]]:
        """Return the chains that begin with a joint: one, or those it divides into."""
        if not joint.turns or joint.mimics is not None:
            return []
        if not joint.lower < joint.upper:
            immovable.append(joint.name)
            return []
        branches = [chain for j in list_moving_joints(joint.child) for chain in follow_chains(j)]
        long_branches = [chain for chain in branches if len(chain) >= FEWEST_JOINTS]
        if len(long_branches) > 1:
            shared.append(joint)
            return long_branches
        # One chain continues, perhaps with small parts next to it; at fingers alone the limb ends
        if len(branches) == 1 or long_branches:
            return [[joint, *(long_branches or branches)[0]]]
        return [[joint]]

    all_chains = [chain for joint in list_moving_joints(base) for chain in follow_chains(joint)]
    limbs = [
        LimbChain(tuple(chain[:MOST_JOINTS]), tuple(chain[MOST_JOINTS:]))
        for chain in all_chains
        if len(chain) >= FEWEST_JOINTS
    ]
    short = {chain[-1].child: len(chain) for chain in all_chains if len(chain) < FEWEST_JOINTS}
    return LimbChains(tuple(limbs), tuple(shared), short, tuple(immovable))


def find_limbs_to(tree: UrdfTree, base: str, links: Sequence[str]) -> LimbChains:
    """Return the chains from the base to links; joints of several are shared.

    Args:
        tree: The URDF.
        base: The body link.
        links: Links at the ends of limbs.

    Raises:
        UsageError: A link does not exist, is not carried by the base, is carried by another one, or
            has fewer joints than a limb.
    """
    paths: list[list[UrdfJoint]] = []
    for link in links:
        if link not in tree.links:
            matches = get_close_matches(link, tree.links, n=1)
            hint = f", did you mean {matches[0]!r}?" if matches else ""
            raise UsageError(f"{tree.path}: no link {link!r}{hint}")
        path = tree.way_to(link, base)
        if path is None:
            raise UsageError(f"{tree.path}: the body {base!r} does not carry link {link!r}")
        paths.append([joint for joint in path if joint.turns and joint.lower < joint.upper])
    count = Counter(joint.name for path in paths for joint in path)
    shared = {j.name: j for path in paths for j in path if count[j.name] > 1}
    limbs = []
    for link, path in zip(links, paths, strict=True):
        joints = [joint for joint in path if joint.name not in shared]
        if len(joints) < FEWEST_JOINTS:
            raise UsageError(
                f"{tree.path}: link {link!r} is moved by {len(joints)} joints of its own, expected "
                f"{FEWEST_JOINTS} or more"
            )
        limbs.append(LimbChain(tuple(joints[:MOST_JOINTS]), tuple(joints[MOST_JOINTS:])))
    return LimbChains(tuple(limbs), tuple(shared.values()), {})


def group_similar_limbs(lengths: dict[int, float], joints: dict[int, int]) -> list[list[int]]:
    """Group limbs with equally many joints and about the same length, the largest group first.

    Args:
        lengths: Length of each limb [m], by its number.
        joints: Number of joints of each limb, by its number.

    Returns:
        The numbers of limbs in each group. Groups of one size come longest first.
    """
    groups: list[list[int]] = []
    for limb in sorted(lengths, key=lambda i: (-joints[i], -lengths[i], i)):
        for group in groups:
            first = group[0]
            is_similar = (
                abs(lengths[limb] - lengths[first]) <= _MAX_LENGTH_DIFFERENCE * lengths[first]
            )
            if joints[first] == joints[limb] and is_similar:
                group.append(limb)
                break
        else:
            groups.append([limb])
    return sorted(groups, key=lambda group: (-len(group), -lengths[group[0]], group[0]))


def select_legs(groups: list[list[int]]) -> list[int]:
    """Return the limbs that are legs: the largest group, or several where that is too small.

    Empty where all limbs together are fewer than three.
    """
    legs: list[int] = []
    for group in groups:
        legs += group
        if len(legs) >= FEWEST_LEGS:
            return sorted(legs)
    return []
