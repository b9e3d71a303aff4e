"""What every exported file tells beside its samples, as JSON: frames, signs, joints, contacts."""

from __future__ import annotations

import json
import math
from pathlib import Path

from climbplan.exports.motion import ExportedJoints, RobotMotion
from climbplan.store.atomic_file import replace_atomically

FORMAT, VERSION = "climbplan/motion", 1
EULER = "R = Rz(yaw) Ry(pitch) Rx(roll), body to world"
FRAMES = {
    "world": "z up; lengths in m, times in s",
    "body": "the planner's frame: of climbs x right, y forward, z up, of walks x forward, y left; "
    "its origin is the centre of mass of the robot as it stands",
    "base": "the frame of the URDF's root link (not of that link's inertia)",
    "quaternions": "x, y, z, w, link to world",
}
SIGNS = {
    "torque": "of motors: positive ones turn a joint in the positive direction of its axis; what "
    "motors bring against contact forces, -J^T force",
    "effort": "what a controller adds to gain * (position - angle)",
    "gravity": "what motors add to hold the weight of the robot's own links, with the sign of "
    "`torque`; part of `effort` where effort_has_gravity is true, of `position` never",
    "force": "on the robot, from what it touches, world frame [N]",
    "motor": "gain * (position - angle) + effort + gravity (unless effort has it) - damping * "
    "velocity",
    "plan file": "instants/joint_torques is J^T force and instants/link_torques the torque of the "
    "links' weight about the joints: motors bring minus both",
}


def collect_facts(motion: RobotMotion) -> dict[str, object]:
    """Return what readers of a motion have to know beside its samples, as plain values."""
    joints, facts = motion.joints, dict(motion.facts)
    toes = facts.pop("toes", {})
    radius = facts.pop("foot_radius", 0.0)
    assert isinstance(toes, dict)
    contacts = motion.contacts
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": motion.name,
        "robot": motion.robot,
        "samples": len(motion.time),
        "seconds": float(motion.time[-1] - motion.time[0]),
        "ramp_s": motion.ramp,
        "base_link": None,
        "euler": EULER,
        "frames": FRAMES,
        "signs": SIGNS,
        "effort_has_gravity": joints is not None and joints.has_gravity_effort,
        "joints": [] if joints is None else _list_joints(joints),
        "contacts": []
        if contacts is None
        else [{"name": name, "radius": radius, **toes.get(name, {})} for name in contacts.names],
        **facts,
        "words": list(motion.words),
    }


def _list_joints(joints: ExportedJoints) -> list[dict[str, object]]:
    rows = []
    for j, name in enumerate(joints.names):
        row: dict[str, object] = {
            "name": name,
            "kind": "slides" if joints.is_sliding(j) else "turns",
            "gain": float(joints.gain[j]),
        }
        if joints.limits is not None:
            row |= {
                "limb": joints.limits.limb[j],
                "gain_rigid": float(joints.limits.rigid_gain[j]),
                "damping": float(joints.limits.damping[j]),
                "max_torque": _replace_infinite(float(joints.limits.max_torque[j])),
            }
        rows.append(row)
    return rows


def _replace_infinite(value: float) -> float | None:
    """Return a number as JSON has them; None of no limit."""
    return value if math.isfinite(value) else None


def write_sidecar(motion: RobotMotion, out: Path) -> None:
    """Write the JSON file of a file: `motion.csv.json` of `motion.csv`."""
    write_facts(motion, out.with_name(f"{out.name}.json"))


def write_facts(motion: RobotMotion, out: Path) -> None:
    """Write a JSON file; raises UsageError if it cannot be written."""
    text = json.dumps(collect_facts(motion), indent=2, allow_nan=False) + "\n"
    with replace_atomically(out) as temporary_path:
        temporary_path.write_text(text, encoding="utf-8")
