"""Joints that follow others: `<mimic joint="a" multiplier="m" offset="b"/>` is q = m q_a + b.

What they follow may itself follow another one; in the end there is a joint with an angle of its
own, whose motor moves them all.
"""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.schema.document import Finding
from climbplan.schema.fields import find_closest_name
from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree

_LARGEST = 1000.0  # multiplier and offset


@dataclass(frozen=True)
class Follows:
    """A joint's place is ratio times that of its leader, plus offset [rad or m]."""

    leader: str  # a joint that follows none
    ratio: float
    offset: float


def resolve_mimic(tree: UrdfTree, joint: UrdfJoint) -> Follows | None:
    """Return the joint that drives a mimic joint; None if it follows no joint or is part of a
    cycle.
    """
    ratio, offset, leading_joint, passed = 1.0, 0.0, joint, {joint.name}
    while leading_joint.mimic is not None:
        offset += ratio * leading_joint.mimic.offset
        ratio *= leading_joint.mimic.multiplier
        leader = tree.joints.get(leading_joint.mimic.joint)
        if leader is None or leader.name in passed:
            return None
        passed.add(leader.name)
        leading_joint = leader
    return Follows(leading_joint.name, ratio, offset) if leading_joint is not joint else None


def check_mimics(tree: UrdfTree) -> list[Finding]:
    """Return mistakes at mimic joints whose leader is missing, cannot move, or forms a cycle."""
    findings = []
    for joint in tree.joints.values():
        if joint.mimic is None:
            continue
        location = tree.format_location(joint.line)
        where = f"joint {joint.name!r} ({location}) mimics {joint.mimic.joint!r}"
        leader = tree.joints.get(joint.mimic.joint)
        if leader is None:
            message = f"{where}, which is no joint of the URDF"
            findings.append(
                Finding(("urdf",), message, find_closest_name(joint.mimic.joint, list(tree.joints)))
            )
        elif not (joint.moves and leader.moves):
            kind = f"a {(joint if not joint.moves else leader).kind} joint"
            message = f"{where}, {kind}; expected joints that turn or slide"
            findings.append(Finding(("urdf",), message))
        elif not all(abs(v) <= _LARGEST for v in (joint.mimic.multiplier, joint.mimic.offset)):
            message = f"{where}: expected `multiplier` and `offset` up to {_LARGEST:g}"
            findings.append(Finding(("urdf",), message))
        elif resolve_mimic(tree, joint) is None and _is_cyclic(tree, joint):
            message = "itself" if leader is joint else "a joint that in the end mimics it"
            findings.append(Finding(("urdf",), f"{where}, {message}; expected one that leads"))
    return findings


def _is_cyclic(tree: UrdfTree, joint: UrdfJoint) -> bool:
    leading_joint, steps = joint, 0
    while (
        leading_joint.mimic is not None
        and leading_joint.mimic.joint in tree.joints
        and steps <= len(tree.joints)
    ):
        leading_joint, steps = tree.joints[leading_joint.mimic.joint], steps + 1
    return steps > len(tree.joints)
