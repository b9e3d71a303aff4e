"""Joints that follow others: `<mimic joint="a" multiplier="m" offset="b"/>` is q = m q_a + b.

What they follow may itself follow another one; in the end there is a joint with an angle of its
own, whose motor moves them all.
"""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.schema.document import Finding
from climbplan.schema.fields import nearest
from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree

_LARGEST = 1000.0  # multiplier and offset


@dataclass(frozen=True)
class Follows:
    """A joint's place is ratio times that of its leader, plus offset [rad or m]."""

    leader: str  # a joint that follows none
    ratio: float
    offset: float


def follows(tree: UrdfTree, joint: UrdfJoint) -> Follows | None:
    """What moves a joint; None of one that moves by itself, and of one that follows in a circle."""
    ratio, offset, here, passed = 1.0, 0.0, joint, {joint.name}
    while here.mimic is not None:
        offset += ratio * here.mimic.offset
        ratio *= here.mimic.multiplier
        leader = tree.joints.get(here.mimic.joint)
        if leader is None or leader.name in passed:
            return None
        passed.add(leader.name)
        here = leader
    return Follows(here.name, ratio, offset) if here is not joint else None


def mimic_findings(tree: UrdfTree) -> list[Finding]:
    """Joints that follow what is not there, what cannot lead, or one another."""
    found = []
    for joint in tree.joints.values():
        if joint.mimic is None:
            continue
        where = f"joint {joint.name!r} ({tree.at(joint.line)}) mimics {joint.mimic.joint!r}"
        leader = tree.joints.get(joint.mimic.joint)
        if leader is None:
            message = f"{where}, which is no joint of the URDF"
            found.append(Finding(("urdf",), message, nearest(joint.mimic.joint, list(tree.joints))))
        elif not (joint.moves and leader.moves):
            kind = f"a {(joint if not joint.moves else leader).kind} joint"
            message = f"{where}, {kind}; expected joints that turn or slide"
            found.append(Finding(("urdf",), message))
        elif not all(abs(v) <= _LARGEST for v in (joint.mimic.multiplier, joint.mimic.offset)):
            message = f"{where}: expected `multiplier` and `offset` up to {_LARGEST:g}"
            found.append(Finding(("urdf",), message))
        elif follows(tree, joint) is None and _in_a_circle(tree, joint):
            message = "itself" if leader is joint else "a joint that in the end mimics it"
            found.append(Finding(("urdf",), f"{where}, {message}; expected one that leads"))
    return found


def _in_a_circle(tree: UrdfTree, joint: UrdfJoint) -> bool:
    here, steps = joint, 0
    while here.mimic is not None and here.mimic.joint in tree.joints and steps <= len(tree.joints):
        here, steps = tree.joints[here.mimic.joint], steps + 1
    return steps > len(tree.joints)
