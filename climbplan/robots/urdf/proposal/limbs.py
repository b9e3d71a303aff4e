"""Which parts of a URDF are limbs: chains of joints that carry nothing further that moves well.

From every joint that the body carries the chain is followed outwards. Where it divides into several
chains of at least three joints each, what came before is shared by them (a waist) and has to be
locked; where it divides into shorter ones (fingers), the limb ends. Joints that push, follow others
or cannot move (lower bound equal to upper, wheels that are held) end a limb, too. Legs are the
largest group of limbs that are alike.
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

_ALIKE = 0.2  # by which lengths of limbs of a group may differ


@dataclass(frozen=True)
class FoundLimb:
    """One limb, from the body outwards."""

    joints: tuple[UrdfJoint, ...]  # that are to move it, at most seven
    locked: tuple[UrdfJoint, ...]  # further out, to be held

    @property
    def end(self) -> str:
        """The link that its last joint moves."""
        return self.joints[-1].child


@dataclass(frozen=True)
class FoundLimbs:
    """Limbs of a URDF, and the joints that several of them share."""

    limbs: tuple[FoundLimb, ...]
    shared: tuple[UrdfJoint, ...]
    short: dict[str, int]  # joints of chains too short for a limb, by the link that they end at
    still: tuple[str, ...] = ()  # joints at which limbs end because their bounds leave no motion


def body_link(tree: UrdfTree) -> str:
    """The link that is the body: the root, or what a floating joint carries below it."""
    here = (tree.roots or [""])[0]
    for joint in tree.joints.values():
        if joint.kind == "floating" and joint.parent == here:
            return joint.child
    return here


def limbs_of(tree: UrdfTree, base: str) -> FoundLimbs:
    """All limbs of three joints or more that the base carries."""
    carries: dict[str, list[UrdfJoint]] = {}
    for joint in tree.joints.values():
        carries.setdefault(joint.parent, []).append(joint)

    def moving(link: str) -> list[UrdfJoint]:
        """Joints that move and are carried by the rigid body of a link."""
        found = []
        for joint in carries.get(link, []):
            found += moving(joint.child) if joint.kind == "fixed" else [joint]
        return found

    shared: list[UrdfJoint] = []
    still: list[str] = []

    def chains(joint: UrdfJoint) -> list[list[UrdfJoint]]:
        """The chains that begin with a joint: one, or those it divides into."""
        if not joint.turns or joint.mimics is not None:
            return []
        if not joint.lower < joint.upper:
            still.append(joint.name)
            return []
        further = [chain for j in moving(joint.child) for chain in chains(j)]
        long = [chain for chain in further if len(chain) >= FEWEST_JOINTS]
        if len(long) > 1:
            shared.append(joint)
            return long
        # One way goes on, with small parts beside it or none; among fingers alone the limb ends
        if len(further) == 1 or long:
            return [[joint, *(long or further)[0]]]
        return [[joint]]

    found = [chain for joint in moving(base) for chain in chains(joint)]
    limbs = [
        FoundLimb(tuple(chain[:MOST_JOINTS]), tuple(chain[MOST_JOINTS:]))
        for chain in found
        if len(chain) >= FEWEST_JOINTS
    ]
    short = {chain[-1].child: len(chain) for chain in found if len(chain) < FEWEST_JOINTS}
    return FoundLimbs(tuple(limbs), tuple(shared), short, tuple(still))


def limbs_to(tree: UrdfTree, base: str, links: Sequence[str]) -> FoundLimbs:
    """The chains from the base to links; joints of several are shared.

    Raises UsageError for links that are none, that the base does not carry, that are carried by
    one another, or by fewer joints than limbs have.
    """
    ways: list[list[UrdfJoint]] = []
    for link in links:
        if link not in tree.links:
            near = get_close_matches(link, tree.links, n=1)
            hint = f", did you mean {near[0]!r}?" if near else ""
            raise UsageError(f"{tree.path}: no link {link!r}{hint}")
        way = tree.way_to(link, base)
        if way is None:
            raise UsageError(f"{tree.path}: the body {base!r} does not carry link {link!r}")
        ways.append([joint for joint in way if joint.turns and joint.lower < joint.upper])
    count = Counter(joint.name for way in ways for joint in way)
    shared = {j.name: j for way in ways for j in way if count[j.name] > 1}
    limbs = []
    for link, way in zip(links, ways, strict=True):
        own = [joint for joint in way if joint.name not in shared]
        if len(own) < FEWEST_JOINTS:
            raise UsageError(
                f"{tree.path}: link {link!r} is moved by {len(own)} joints of its own, expected "
                f"{FEWEST_JOINTS} or more"
            )
        limbs.append(FoundLimb(tuple(own[:MOST_JOINTS]), tuple(own[MOST_JOINTS:])))
    return FoundLimbs(tuple(limbs), tuple(shared.values()), {})


def alike(lengths: dict[int, float], joints: dict[int, int]) -> list[list[int]]:
    """Groups of limbs with equally many joints and about the same length, the largest first.

    lengths: [m] by limb; joints: their number by limb. Groups of one size come longest first.
    """
    groups: list[list[int]] = []
    for limb in sorted(lengths, key=lambda i: (-joints[i], -lengths[i], i)):
        for group in groups:
            first = group[0]
            close = abs(lengths[limb] - lengths[first]) <= _ALIKE * lengths[first]
            if joints[first] == joints[limb] and close:
                group.append(limb)
                break
        else:
            groups.append([limb])
    return sorted(groups, key=lambda group: (-len(group), -lengths[group[0]], group[0]))


def legs_among(groups: list[list[int]]) -> list[int]:
    """The limbs that are to be legs: the largest group, or several where that is too small.

    Empty where all limbs together are fewer than three.
    """
    chosen: list[int] = []
    for group in groups:
        chosen += group
        if len(chosen) >= FEWEST_LEGS:
            return sorted(chosen)
    return []
