"""Find every mistake in a robot section that names a URDF, as far as both texts show it.

Each is told at the key of the section that is at fault, with the line of the URDF.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from climbplan.schema.document import Finding
from climbplan.schema.fields import find_closest_name
from climbplan.schema.robots.ranges import ANGLE, PLACE, SPEED, TORQUE
from climbplan.schema.robots.urdf.mimics import check_mimics, resolve_mimic
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


def check_tree(tree: UrdfTree) -> list[Finding]:
    """Return mistakes that keep a URDF from being a tree of links with non-negative masses."""
    findings = []
    carriers: dict[str, list[UrdfJoint]] = {}
    for joint in tree.joints.values():
        carriers.setdefault(joint.child, []).append(joint)
    for link, joints in carriers.items():
        if len(joints) > 1:
            names = " and ".join(f"{j.name!r} ({tree.format_location(j.line)})" for j in joints)
            findings.append(
                Finding(
                    ("urdf",),
                    f"closed chain: link {link!r} is the child of joints {names}; expected a tree, "
                    "with one parent a link (five-bar legs are told by a robot file of `five_bar`)",
                )
            )
    carried = tree.by_child
    for name in tree.links if not findings else ():
        link_name, steps = name, 0
        while link_name in carried and steps <= len(tree.links):
            link_name, steps = carried[link_name].parent, steps + 1
        if link_name in carried:
            loop = f"closed chain: link {name!r} is carried by itself"
            findings.append(
                Finding(("urdf",), f"{loop} ({tree.format_location(tree.links[name].line)})")
            )
            break
    if len(tree.roots) > 1:
        findings.append(
            Finding(("urdf",), f"expected one root link, got {_join_names(tree.roots)} unconnected")
        )
    findings += [
        Finding(
            ("urdf",),
            f"link {link.name!r} has the mass {link.mass:g} kg ({tree.format_location(link.line)})",
        )
        for link in tree.links.values()
        if link.mass < 0
    ]
    return findings + check_mimics(tree)


def check_section(spec: UrdfRobotSpec, tree: UrdfTree, base: str) -> list[Finding]:
    """Return mistakes of the section beside its legs: base, joints, mass."""
    findings = []
    if base not in tree.links:
        findings.append(_report_unknown(("base",), "link", base, tree.links))
    findings += [
        _report_unknown(("joints", name), "joint", name, tree.joints)
        for name in spec.joints
        if name not in tree.joints
    ]
    findings += [
        _report_unknown(("limb_radii", name), "joint", name, tree.joints)
        for name in spec.limb_radii
        if name not in tree.joints
    ]
    findings += _check_locked(spec, tree)
    if sum(link.mass for link in tree.links.values()) <= 0:
        message = "zero mass: no link of the URDF has any, and so it has no centre of mass"
        cure = "expected <inertial> in its links; `mass` alone does not tell where it acts"
        findings.append(Finding(("urdf",), f"{message}; {cure}"))
    return findings


def _check_locked(spec: UrdfRobotSpec, tree: UrdfTree) -> Iterator[Finding]:
    """Yield mistakes at locked joints: missing, of another kind, or beyond their bounds."""
    for key, positions, kind, other_key in (
        ("locked", spec.locked, "turns", "locked_m"),
        ("locked_m", spec.locked_m, "slides", "locked"),
    ):
        for name, value in positions.items():
            path = (key, name)
            joint = tree.joints.get(name)
            if joint is None:
                yield _report_unknown(path, "joint", name, tree.joints)
            elif not (joint.turns if kind == "turns" else joint.slides):
                cure = f"; `{other_key}: {{{name}: NUMBER}}` holds it" if joint.moves else ""
                location = tree.format_location(joint.line)
                message = f"a {joint.kind} joint, {location}; expected one that {kind}"
                yield Finding(path, message + cure)
            elif not _is_within_bounds(joint, value):
                yield Finding(path, _describe_out_of_bounds(joint, value))
            if name in spec.joints:
                yield Finding(("joints", name), "locked: it has no limits and no stiffness")


def check_legs(spec: UrdfRobotSpec, tree: UrdfTree, base: str) -> Iterator[Finding]:
    """Yield mistakes of all legs, and joints that two of them share."""
    owners: dict[str, str] = {}
    chains: dict[str, list[UrdfJoint]] = {}
    for name, leg in spec.legs.items():
        leg_path = ("legs", name)
        if leg.toe not in tree.links:
            yield _report_unknown((*leg_path, "toe"), "link", leg.toe, tree.links)
            continue
        if base not in tree.links:
            continue
        chain = tree.way_to(leg.toe, base)
        if chain is None:
            yield Finding(
                (*leg_path, "toe"), f"link {leg.toe!r} is not carried by the base {base!r}"
            )
            continue
        chains[name] = chain
        moving = select_moving_joints(chain, spec, tree)
        for joint in moving:
            where = f"joint {joint.name!r} ({tree.format_location(joint.line)})"
            for message in check_joint(joint, spec):
                yield Finding((*leg_path, "toe"), f"{where}: {message}")
            owner = owners.setdefault(joint.name, name)
            if owner != name:
                key = "locked_m" if joint.slides else "locked"
                yield Finding(
                    (*leg_path, "toe"),
                    f"{where} moves {owner} and {name} together; expected joints of its own for "
                    "every leg, the last common link as `base`, or it held: "
                    f"`{key}: {{{joint.name}: {'METRES' if joint.slides else 'DEGREES'}}}`",
                )
        driven_joints = [joint for joint in moving if joint.mimic is None]
        if not FEWEST_JOINTS <= len(driven_joints) <= MOST_JOINTS:
            yield Finding(
                (*leg_path, "toe"),
                f"expected {FEWEST_JOINTS} to {MOST_JOINTS} joints that move from {base!r} to "
                f"{leg.toe!r}, got {len(driven_joints)}{': ' if driven_joints else ''}"
                f"{', '.join(joint.name for joint in driven_joints)}"
                + ("; `locked` holds some" if len(driven_joints) > MOST_JOINTS else "")
                + (_PLANE if len(driven_joints) == FEWEST_JOINTS - 1 else ""),
            )
        elif spec.flat_feet and len(driven_joints) < JOINTS_OF_FLAT_FEET:
            message = (
                f"a leg with a flat foot has at least {JOINTS_OF_FLAT_FEET} joints, got "
                f"{', '.join(joint.name for joint in driven_joints)}; `foot: {{radius: NUMBER}}` "
                "or no `foot` is for legs without an ankle"
            )
            yield Finding((*leg_path, "toe"), message)
        if spec.gripper is not None and len(moving) > JOINTS_BELOW_WRIST:
            message = (
                f"a leg with a gripper has {JOINTS_BELOW_WRIST} joints below its wrist, got "
                f"{', '.join(joint.name for joint in moving)}; name the link of the wrist's centre "
                "as its toe, or hold some joints by `locked`"
            )
            yield Finding((*leg_path, "toe"), message)
        yield from _check_posture(name, leg, driven_joints)
        yield from _check_followers(name, spec, tree, moving)
    yield from _check_foreign_leaders(spec, tree, chains, owners)


def select_moving_joints(
    chain: list[UrdfJoint], spec: UrdfRobotSpec, tree: UrdfTree
) -> list[UrdfJoint]:
    """Return the joints of a chain that a leg moves: neither fixed nor locked.

    Those that follow another joint are among them where that one is.
    """
    locked = spec.locked_positions
    unlocked = [joint for joint in chain if joint.kind != "fixed" and joint.name not in locked]
    names = {joint.name for joint in unlocked}

    def is_moved(joint: UrdfJoint) -> bool:
        leader = resolve_mimic(tree, joint)
        return leader is None or (leader.leader in names and leader.ratio != 0.0)

    return [joint for joint in unlocked if is_moved(joint)]


def check_joint(joint: UrdfJoint, spec: UrdfRobotSpec) -> Iterator[str]:
    """Yield why a leg cannot have a joint."""
    if not joint.moves:
        body = "; is its child the body (`base`)?" if joint.kind == "floating" else ""
        yield f"a {joint.kind} joint; expected revolute, continuous, prismatic or fixed{body}"
        return
    allowed = PLACE if joint.slides else ANGLE
    if joint.kind != "continuous" and not (
        allowed.holds(joint.lower) and allowed.holds(joint.upper)
    ):
        endless = "" if joint.slides else '; a joint without bounds has type="continuous"'
        bounds_text = f"got {joint.lower:g} and {joint.upper:g}"
        yield f"expected bounds {allowed.expected}, {bounds_text}{endless}"
    elif not joint.lower < joint.upper:
        bounds = f"{joint.lower:g} and {joint.upper:g} {allowed.unit}"
        yield f"expected <limit> with lower < upper, got {bounds}"
    if joint.mimic is not None:  # the motor is that of the joint that it follows
        return
    torque, speed = ("force", "m/s") if joint.slides else ("torque", "rad/s")
    joint_spec = spec.joints.get(joint.name)
    if (joint_spec is None or joint_spec.max_torque is None) and not (
        joint.effort or 0.0
    ) >= TORQUE.low:
        unit = "N" if joint.slides else "N m"
        yield _describe_missing_limit(
            "effort", torque, unit, joint.effort, joint.name, "max_torque"
        )
    if (joint_spec is None or joint_spec.max_speed is None) and not (
        joint.velocity or 0.0
    ) >= SPEED.low:
        yield _describe_missing_limit(
            "velocity", "speed", speed, joint.velocity, joint.name, "max_speed"
        )


def compute_leader_bounds(
    tree: UrdfTree, joint: UrdfJoint, followers: Iterable[UrdfJoint]
) -> tuple[float, float]:
    """Return bounds of a joint [rad, m] that keep its mimic joints within their own bounds.

    Args:
        tree: The URDF.
        joint: The joint that others follow.
        followers: Mimic joints; those of other joints are passed over.

    Returns:
        Lower and upper bound; lower > upper where no place keeps all of them.
    """
    low, high = joint.lower, joint.upper
    for follower in followers:
        coupling = resolve_mimic(tree, follower)
        if coupling is not None and coupling.leader == joint.name and coupling.ratio != 0.0:
            ends = [
                (bound - coupling.offset) / coupling.ratio
                for bound in (follower.lower, follower.upper)
            ]
            low, high = max(low, min(ends)), min(high, max(ends))
    return low, high


def _check_followers(
    name: str, spec: UrdfRobotSpec, tree: UrdfTree, moving: list[UrdfJoint]
) -> Iterator[Finding]:
    """Yield mistakes at mimic joints: limits of their own, and bounds that leave their leader no
    range.
    """
    for joint in moving:
        if joint.mimic is None:
            low, high = compute_leader_bounds(tree, joint, moving)
            if joint.lower < joint.upper and not low < high:
                yield Finding(
                    ("legs", name, "toe"),
                    f"joint {joint.name!r} ({tree.format_location(joint.line)}): no place within "
                    "its bounds keeps the joints that mimic it within theirs",
                )
        elif joint.name in spec.joints:
            message = f"mimics {joint.mimic.joint!r}: it has no limits and no stiffness of its own"
            yield Finding(("joints", joint.name), message)


def _check_foreign_leaders(
    spec: UrdfRobotSpec, tree: UrdfTree, chains: dict[str, list[UrdfJoint]], owners: dict[str, str]
) -> Iterator[Finding]:
    """Yield joints that follow a joint of another leg: they would move both."""
    for name, chain in chains.items():
        for joint in chain:
            coupling = resolve_mimic(tree, joint)
            if coupling is None or joint.name in spec.locked_positions or coupling.ratio == 0.0:
                continue
            owner = owners.get(coupling.leader, name)
            if owner != name:
                yield Finding(
                    ("legs", name, "toe"),
                    f"joint {joint.name!r} ({tree.format_location(joint.line)}): mimics "
                    f"{coupling.leader!r}, a joint of {owner}; expected joints of one leg, "
                    "or it held by `locked`",
                )


def _describe_missing_limit(
    attribute: str, what: str, unit: str, limit: float | None, joint: str, key: str
) -> str:
    limit_text = "none" if limit is None else f"{limit:g}"
    return (
        f"no {what} limit: expected `{attribute}` > 0 in its <limit>, got {limit_text}, or "
        f"`joints: {{{joint}: {{{key}: NUMBER}}}}` [{unit}] here"
    )


def _check_posture(name: str, leg: UrdfLegSpec, moving: list[UrdfJoint]) -> Iterator[Finding]:
    """Yield angles and places for joints that the leg has, within their bounds."""
    joints_by_name = {joint.name: joint for joint in moving}
    for key, positions in (("posture_deg", leg.posture_deg), ("posture_m", leg.posture_m)):
        for joint, value in positions.items():
            path = ("legs", name, key, joint)
            if joint not in joints_by_name:
                message = f"leg {name} has no joint {joint!r}, only {_join_names(joints_by_name)}"
                yield Finding(path, message, find_closest_name(joint, list(joints_by_name)))
            elif joints_by_name[joint].slides != (key == "posture_m"):
                other_key = "posture_m" if joints_by_name[joint].slides else "posture_deg"
                yield Finding(
                    path,
                    f"a {joints_by_name[joint].kind} joint; its posture stands in `{other_key}`",
                )
            elif not _is_within_bounds(joints_by_name[joint], value):
                yield Finding(path, _describe_out_of_bounds(joints_by_name[joint], value))


def _is_within_bounds(joint: UrdfJoint, value: float) -> bool:
    """Return whether an angle [deg], or a place [m] of a sliding joint, is within its bounds."""
    place = value if joint.slides else np.deg2rad(value)
    return bool(joint.lower - 1e-9 <= place <= joint.upper + 1e-9)


def _describe_out_of_bounds(joint: UrdfJoint, value: float) -> str:
    if joint.slides:
        return (
            f"expected a place within the joint's bounds, {joint.lower:.4g} to {joint.upper:.4g} "
            f"m, got {value:g}"
        )
    return (
        f"expected an angle within the joint's bounds, {np.rad2deg(joint.lower):.4g} to "
        f"{np.rad2deg(joint.upper):.4g} deg, got {value:g}"
    )


def _report_unknown(path: tuple[str, ...], what: str, name: str, entries: object) -> Finding:
    names = list(entries) if isinstance(entries, dict) else []
    return Finding(
        path,
        f"the URDF has no {what} {name!r}, it has {_join_names(names)}",
        find_closest_name(name, names),
    )


def _join_names(names: object) -> str:
    every = [str(name) for name in names] if isinstance(names, dict | list) else []
    more = f" and {len(every) - _NAMED} more" if len(every) > _NAMED else ""
    return f"{', '.join(every[:_NAMED])}{more}" if every else "none"
