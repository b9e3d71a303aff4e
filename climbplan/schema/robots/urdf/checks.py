"""Every mistake in a robot section that names a URDF, as far as the text of both tells.

Each is told at the key of the section that is at fault, with the line of the URDF.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from climbplan.schema.document import Finding
from climbplan.schema.fields import nearest
from climbplan.schema.robots.ranges import ANGLE, PLACE, SPEED, TORQUE
from climbplan.schema.robots.urdf.mimics import follows, mimic_findings
from climbplan.schema.robots.urdf.model import UrdfLegSpec, UrdfRobotSpec
from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree

FEWEST_JOINTS, MOST_JOINTS = 3, 7
JOINTS_OF_FLAT_FEET = 6  # that put a sole anywhere, lying in any way
JOINTS_BELOW_WRIST = 3  # with more a gripper's moment would have a say in how a leg settles
_PLANE = (
    "; with two a toe moves on a surface alone, and where it stands beside that follows from the "
    "body, which is not planned"
)
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
                    "with one parent a link (five-bar legs are told by a robot file of `five_bar`)",
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
    return found + mimic_findings(tree)


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
    found += _held_findings(spec, tree)
    if sum(link.mass for link in tree.links.values()) <= 0:
        message = "zero mass: no link of the URDF has any, and so it has no centre of mass"
        cure = "expected <inertial> in its links; `mass` alone does not tell where it acts"
        found.append(Finding(("urdf",), f"{message}; {cure}"))
    return found


def _held_findings(spec: UrdfRobotSpec, tree: UrdfTree) -> Iterator[Finding]:
    """Joints that are locked: there, of the kind that their key is for, within their bounds."""
    for key, given, kind, other in (
        ("locked", spec.locked, "turns", "locked_m"),
        ("locked_m", spec.locked_m, "slides", "locked"),
    ):
        for name, value in given.items():
            path = (key, name)
            joint = tree.joints.get(name)
            if joint is None:
                yield _unknown(path, "joint", name, tree.joints)
            elif not (joint.turns if kind == "turns" else joint.slides):
                cure = f"; `{other}: {{{name}: NUMBER}}` holds it" if joint.moves else ""
                message = f"a {joint.kind} joint, {tree.at(joint.line)}; expected one that {kind}"
                yield Finding(path, message + cure)
            elif not _within(joint, value):
                yield Finding(path, _out_of_bounds(joint, value))
            if name in spec.joints:
                yield Finding(("joints", name), "locked: it has no limits and no stiffness")


def leg_findings(spec: UrdfRobotSpec, tree: UrdfTree, base: str) -> Iterator[Finding]:
    """Mistakes of all legs, and joints that two of them share."""
    owners: dict[str, str] = {}
    ways: dict[str, list[UrdfJoint]] = {}
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
        ways[name] = way
        moving = moving_joints(way, spec, tree)
        for joint in moving:
            where = f"joint {joint.name!r} ({tree.at(joint.line)})"
            for message in joint_faults(joint, spec):
                yield Finding((*here, "toe"), f"{where}: {message}")
            owner = owners.setdefault(joint.name, name)
            if owner != name:
                key = "locked_m" if joint.slides else "locked"
                yield Finding(
                    (*here, "toe"),
                    f"{where} moves {owner} and {name} together; expected joints of its own for "
                    "every leg, the last common link as `base`, or it held: "
                    f"`{key}: {{{joint.name}: {'METRES' if joint.slides else 'DEGREES'}}}`",
                )
        own = [joint for joint in moving if joint.mimic is None]
        if not FEWEST_JOINTS <= len(own) <= MOST_JOINTS:
            yield Finding(
                (*here, "toe"),
                f"expected {FEWEST_JOINTS} to {MOST_JOINTS} joints that move from {base!r} to "
                f"{leg.toe!r}, got {len(own)}{': ' if own else ''}"
                f"{', '.join(joint.name for joint in own)}"
                + ("; `locked` holds some" if len(own) > MOST_JOINTS else "")
                + (_PLANE if len(own) == FEWEST_JOINTS - 1 else ""),
            )
        elif spec.flat_feet and len(own) < JOINTS_OF_FLAT_FEET:
            message = (
                f"a leg with a flat foot has at least {JOINTS_OF_FLAT_FEET} joints, got "
                f"{', '.join(joint.name for joint in own)}; `foot: {{radius: NUMBER}}` or no "
                "`foot` is for legs without an ankle"
            )
            yield Finding((*here, "toe"), message)
        if spec.gripper is not None and len(moving) > JOINTS_BELOW_WRIST:
            message = (
                f"a leg with a gripper has {JOINTS_BELOW_WRIST} joints below its wrist, got "
                f"{', '.join(joint.name for joint in moving)}; name the link of the wrist's centre "
                "as its toe, or hold some joints by `locked`"
            )
            yield Finding((*here, "toe"), message)
        yield from _posture_findings(name, leg, own)
        yield from _following_findings(name, spec, tree, moving)
    yield from _led_by_others(spec, tree, ways, owners)


def moving_joints(way: list[UrdfJoint], spec: UrdfRobotSpec, tree: UrdfTree) -> list[UrdfJoint]:
    """Joints of a way that a leg moves: neither fixed nor locked.

    Those that follow another joint are among them where that one is.
    """
    held = spec.held
    free = [joint for joint in way if joint.kind != "fixed" and joint.name not in held]
    names = {joint.name for joint in free}

    def is_moved(joint: UrdfJoint) -> bool:
        leader = follows(tree, joint)
        return leader is None or (leader.leader in names and leader.ratio != 0.0)

    return [joint for joint in free if is_moved(joint)]


def joint_faults(joint: UrdfJoint, spec: UrdfRobotSpec) -> Iterator[str]:
    """Why a leg cannot have a joint."""
    if not joint.moves:
        body = "; is its child the body (`base`)?" if joint.kind == "floating" else ""
        yield f"a {joint.kind} joint; expected revolute, continuous, prismatic or fixed{body}"
        return
    allowed = PLACE if joint.slides else ANGLE
    if joint.kind != "continuous" and not (
        allowed.holds(joint.lower) and allowed.holds(joint.upper)
    ):
        endless = "" if joint.slides else '; a joint without bounds has type="continuous"'
        got = f"got {joint.lower:g} and {joint.upper:g}"
        yield f"expected bounds {allowed.expected}, {got}{endless}"
    elif not joint.lower < joint.upper:
        bounds = f"{joint.lower:g} and {joint.upper:g} {allowed.unit}"
        yield f"expected <limit> with lower < upper, got {bounds}"
    if joint.mimic is not None:  # the motor is that of the joint that it follows
        return
    torque, speed = ("force", "m/s") if joint.slides else ("torque", "rad/s")
    own = spec.joints.get(joint.name)
    if (own is None or own.max_torque is None) and not (joint.effort or 0.0) >= TORQUE.low:
        unit = "N" if joint.slides else "N m"
        yield _unlimited("effort", torque, unit, joint.effort, joint.name, "max_torque")
    if (own is None or own.max_speed is None) and not (joint.velocity or 0.0) >= SPEED.low:
        yield _unlimited("velocity", "speed", speed, joint.velocity, joint.name, "max_speed")


def led_bounds(
    tree: UrdfTree, joint: UrdfJoint, followers: Iterable[UrdfJoint]
) -> tuple[float, float]:
    """Bounds of a joint [rad, m] within which it keeps those that follow it inside theirs."""
    low, high = joint.lower, joint.upper
    for other in followers:
        led = follows(tree, other)
        if led is not None and led.leader == joint.name and led.ratio != 0.0:
            ends = [(bound - led.offset) / led.ratio for bound in (other.lower, other.upper)]
            low, high = max(low, min(ends)), min(high, max(ends))
    return low, high


def _following_findings(
    name: str, spec: UrdfRobotSpec, tree: UrdfTree, moving: list[UrdfJoint]
) -> Iterator[Finding]:
    """Joints that follow others: nothing is said of them but by these, and bounds leave a range."""
    for joint in moving:
        if joint.mimic is None:
            low, high = led_bounds(tree, joint, moving)
            if joint.lower < joint.upper and not low < high:
                yield Finding(
                    ("legs", name, "toe"),
                    f"joint {joint.name!r} ({tree.at(joint.line)}): no place within its bounds "
                    "keeps the joints that mimic it within theirs",
                )
        elif joint.name in spec.joints:
            message = f"mimics {joint.mimic.joint!r}: it has no limits and no stiffness of its own"
            yield Finding(("joints", joint.name), message)


def _led_by_others(
    spec: UrdfRobotSpec, tree: UrdfTree, ways: dict[str, list[UrdfJoint]], owners: dict[str, str]
) -> Iterator[Finding]:
    """Joints that follow a joint of another leg: they would move both."""
    for name, way in ways.items():
        for joint in way:
            led = follows(tree, joint)
            if led is None or joint.name in spec.held or led.ratio == 0.0:
                continue
            owner = owners.get(led.leader, name)
            if owner != name:
                yield Finding(
                    ("legs", name, "toe"),
                    f"joint {joint.name!r} ({tree.at(joint.line)}): mimics {led.leader!r}, a joint "
                    f"of {owner}; expected joints of one leg, or it held by `locked`",
                )


def _unlimited(
    attribute: str, what: str, unit: str, given: float | None, joint: str, key: str
) -> str:
    got = "none" if given is None else f"{given:g}"
    return (
        f"no {what} limit: expected `{attribute}` > 0 in its <limit>, got {got}, or "
        f"`joints: {{{joint}: {{{key}: NUMBER}}}}` [{unit}] here"
    )


def _posture_findings(name: str, leg: UrdfLegSpec, moving: list[UrdfJoint]) -> Iterator[Finding]:
    """Angles and places for joints that the leg has, within their bounds."""
    own = {joint.name: joint for joint in moving}
    for key, given in (("posture_deg", leg.posture_deg), ("posture_m", leg.posture_m)):
        for joint, value in given.items():
            path = ("legs", name, key, joint)
            if joint not in own:
                message = f"leg {name} has no joint {joint!r}, only {_listed(own)}"
                yield Finding(path, message, nearest(joint, list(own)))
            elif own[joint].slides != (key == "posture_m"):
                other = "posture_m" if own[joint].slides else "posture_deg"
                yield Finding(path, f"a {own[joint].kind} joint; its posture stands in `{other}`")
            elif not _within(own[joint], value):
                yield Finding(path, _out_of_bounds(own[joint], value))


def _within(joint: UrdfJoint, value: float) -> bool:
    """Whether an angle [deg], or a place [m] of a joint that slides, is within its bounds."""
    place = value if joint.slides else np.deg2rad(value)
    return bool(joint.lower - 1e-9 <= place <= joint.upper + 1e-9)


def _out_of_bounds(joint: UrdfJoint, value: float) -> str:
    if joint.slides:
        return (
            f"expected a place within the joint's bounds, {joint.lower:.4g} to {joint.upper:.4g} "
            f"m, got {value:g}"
        )
    return (
        f"expected an angle within the joint's bounds, {np.rad2deg(joint.lower):.4g} to "
        f"{np.rad2deg(joint.upper):.4g} deg, got {value:g}"
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
