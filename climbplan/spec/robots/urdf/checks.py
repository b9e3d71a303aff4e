"""Every mistake in a robot section that names a URDF, as far as the text of both tells.

Each is told at the key of the section that is at fault, with the line of the URDF.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.spec.document import Finding
from climbplan.spec.fields import nearest
from climbplan.spec.robots.ranges import ANGLE, SPEED, TORQUE
from climbplan.spec.robots.urdf.model import UrdfLegSpec, UrdfRobotSpec
from climbplan.spec.robots.urdf.tree import UrdfJoint, UrdfTree

FEWEST_JOINTS, MOST_JOINTS = 3, 7
JOINTS_BELOW_WRIST = 3  # with more a gripper's moment would have a say in how a leg settles
_NAMED = 8  # names listed in a message


def tree_findings(tree: UrdfTree) -> list[Finding]:
    """What makes a URDF no tree of links, or a robot without mass."""
    found = []
    carriers: dict[str, list[UrdfJoint]] = {}
    for joint in tree.joints.values():
        carriers.setdefault(joint.child, []).append(joint)
    for link, joints in carriers.items():
        if len(joints) > 1:
            names = " and ".join(f"{j.name!r} ({tree.at(j.line)})" for j in joints)
            found.append(
                Finding(
                    ("urdf",),
                    f"closed chain: link {link!r} is the child of joints {names}; expected a tree, "
                    "with one parent a link",
                )
            )
    carried = tree.by_child
    for name in tree.links if not found else ():
        here, steps = name, 0
        while here in carried and steps <= len(tree.links):
            here, steps = carried[here].parent, steps + 1
        if here in carried:
            loop = f"closed chain: link {name!r} is carried by itself"
            found.append(Finding(("urdf",), f"{loop} ({tree.at(tree.links[name].line)})"))
            break
    if len(tree.roots) > 1:
        found.append(
            Finding(("urdf",), f"expected one root link, got {_listed(tree.roots)} unconnected")
        )
    found += [
        Finding(
            ("urdf",), f"link {link.name!r} has the mass {link.mass:g} kg ({tree.at(link.line)})"
        )
        for link in tree.links.values()
        if link.mass < 0
    ]
    return found


def section_findings(spec: UrdfRobotSpec, tree: UrdfTree, base: str) -> list[Finding]:
    """Mistakes of the section beside its legs: base, joints, mass."""
    found = []
    if base not in tree.links:
        found.append(_unknown(("base",), "link", base, tree.links))
    found += [
        _unknown(("joints", name), "joint", name, tree.joints)
        for name in spec.joints
        if name not in tree.joints
    ]
    found += [
        _unknown(("limb_radii", name), "joint", name, tree.joints)
        for name in spec.limb_radii
        if name not in tree.joints
    ]
    for name, degrees in spec.locked.items():
        path = ("locked", name)
        joint = tree.joints.get(name)
        if joint is None:
            found.append(_unknown(path, "joint", name, tree.joints))
        elif not joint.turns:
            message = f"a {joint.kind} joint, {tree.at(joint.line)}; expected one that turns"
            found.append(Finding(path, message))
        elif not _within(joint, degrees):
            found.append(Finding(path, _out_of_bounds(joint, degrees)))
        if name in spec.joints:
            found.append(Finding(("joints", name), "locked: it has no limits and no stiffness"))
    if sum(link.mass for link in tree.links.values()) <= 0:
        message = "zero mass: no link of the URDF has any, and so it has no centre of mass"
        cure = "expected <inertial> in its links; `mass` alone does not tell where it acts"
        found.append(Finding(("urdf",), f"{message}; {cure}"))
    return found


def leg_findings(spec: UrdfRobotSpec, tree: UrdfTree, base: str) -> Iterator[Finding]:
    """Mistakes of all legs, and joints that two of them share."""
    owners: dict[str, str] = {}
    for name, leg in spec.legs.items():
        here = ("legs", name)
        if leg.toe not in tree.links:
            yield _unknown((*here, "toe"), "link", leg.toe, tree.links)
            continue
        if base not in tree.links:
            continue
        way = tree.way_to(leg.toe, base)
        if way is None:
            yield Finding((*here, "toe"), f"link {leg.toe!r} is not carried by the base {base!r}")
            continue
        moving = moving_joints(way, spec)
        for joint in moving:
            where = f"joint {joint.name!r} ({tree.at(joint.line)})"
            for message in joint_faults(joint, spec):
                yield Finding((*here, "toe"), f"{where}: {message}")
            owner = owners.setdefault(joint.name, name)
            if owner != name:
                yield Finding(
                    (*here, "toe"),
                    f"{where} moves {owner} and {name} together; expected joints of its own for "
                    "every leg, the last common link as `base`, or it held: "
                    f"`locked: {{{joint.name}: DEGREES}}`",
                )
        if not FEWEST_JOINTS <= len(moving) <= MOST_JOINTS:
            yield Finding(
                (*here, "toe"),
                f"expected {FEWEST_JOINTS} to {MOST_JOINTS} joints that move from {base!r} to "
                f"{leg.toe!r}, got {len(moving)}{': ' if moving else ''}"
                f"{', '.join(joint.name for joint in moving)}"
                + ("; `locked` holds some" if len(moving) > MOST_JOINTS else ""),
            )
        if spec.gripper is not None and len(moving) > JOINTS_BELOW_WRIST:
            message = (
                f"a leg with a gripper has {JOINTS_BELOW_WRIST} joints below its wrist, got "
                f"{', '.join(joint.name for joint in moving)}; name the link of the wrist's centre "
                "as its toe, or hold some joints by `locked`"
            )
            yield Finding((*here, "toe"), message)
        yield from _posture_findings(name, leg, moving)


def moving_joints(way: list[UrdfJoint], spec: UrdfRobotSpec) -> list[UrdfJoint]:
    """Joints of a way that a leg moves: neither fixed nor locked."""
    return [joint for joint in way if joint.kind != "fixed" and joint.name not in spec.locked]


def joint_faults(joint: UrdfJoint, spec: UrdfRobotSpec) -> Iterator[str]:
    """Why a leg cannot have a joint."""
    if not joint.turns:
        body = "; is its child the body (`base`)?" if joint.kind == "floating" else ""
        yield f"a {joint.kind} joint; expected revolute, continuous or fixed{body}"
        return
    if joint.mimics is not None:
        yield (
            f"mimics {joint.mimics!r}; expected joints that move on their own (a coupled pair is "
            "one joint: give the other link to it, or make it fixed)"
        )
    if joint.kind == "revolute" and not (ANGLE.holds(joint.lower) and ANGLE.holds(joint.upper)):
        yield (
            f"expected bounds {ANGLE.expected}, got {joint.lower:g} and {joint.upper:g}; "
            'a joint without bounds has type="continuous"'
        )
    elif not joint.lower < joint.upper:
        yield f"expected <limit> with lower < upper, got {joint.lower:g} and {joint.upper:g} rad"
    own = spec.joints.get(joint.name)
    if (own is None or own.max_torque is None) and not (joint.effort or 0.0) >= TORQUE.low:
        yield _unlimited("effort", "torque", "N m", joint.effort, joint.name, "max_torque")
    if (own is None or own.max_speed is None) and not (joint.velocity or 0.0) >= SPEED.low:
        yield _unlimited("velocity", "speed", "rad/s", joint.velocity, joint.name, "max_speed")


def _unlimited(
    attribute: str, what: str, unit: str, given: float | None, joint: str, key: str
) -> str:
    got = "none" if given is None else f"{given:g}"
    return (
        f"no {what} limit: expected `{attribute}` > 0 in its <limit>, got {got}, or "
        f"`joints: {{{joint}: {{{key}: NUMBER}}}}` [{unit}] here"
    )


def _posture_findings(name: str, leg: UrdfLegSpec, moving: list[UrdfJoint]) -> Iterator[Finding]:
    """Angles for joints that the leg has, within their bounds."""
    own = {joint.name: joint for joint in moving}
    for joint, degrees in leg.posture_deg.items():
        path = ("legs", name, "posture_deg", joint)
        if joint not in own:
            yield Finding(
                path,
                f"leg {name} has no joint {joint!r}, only {_listed(own)}",
                nearest(joint, list(own)),
            )
            continue
        if not _within(own[joint], degrees):
            yield Finding(path, _out_of_bounds(own[joint], degrees))


def _within(joint: UrdfJoint, degrees: float) -> bool:
    return bool(joint.lower - 1e-9 <= np.deg2rad(degrees) <= joint.upper + 1e-9)


def _out_of_bounds(joint: UrdfJoint, degrees: float) -> str:
    return (
        f"expected an angle within the joint's bounds, {np.rad2deg(joint.lower):.4g} to "
        f"{np.rad2deg(joint.upper):.4g} deg, got {degrees:g}"
    )


def _unknown(path: tuple[str, ...], what: str, name: str, known: object) -> Finding:
    names = list(known) if isinstance(known, dict) else []
    return Finding(
        path, f"the URDF has no {what} {name!r}, it has {_listed(names)}", nearest(name, names)
    )


def _listed(names: object) -> str:
    every = [str(name) for name in names] if isinstance(names, dict | list) else []
    more = f" and {len(every) - _NAMED} more" if len(every) > _NAMED else ""
    return f"{', '.join(every[:_NAMED])}{more}" if every else "none"
