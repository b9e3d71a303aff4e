"""Robots for which nothing could be proposed: their refusals, looked at without a robot file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.zoo.second.look import CLIMBS, COUNT, Look, second_look
from benchmarks.zoo.second.planar import short_limbs
from benchmarks.zoo.second.subject import Subject, subject_of_robot
from climbplan.robots.urdf.pinocchio_model import import_pinocchio
from climbplan.robots.urdf.proposal.limbs import find_body_link, find_limbs
from climbplan.robots.urdf.proposal.propose_robot import (
    detect_legs,
    prepare_detected_legs,
    read_tree,
)

_DRAWN = 1000  # postures of two legs


def unproposed(urdf: Path, column: str, words: str, seed: int, count: int = COUNT) -> Look:
    """Look again at the refusal of a robot for which nothing could be proposed."""
    short = short_limbs(urdf, seed)
    if "limit of climbplan" in words and short:
        return Look("limit of ours", short)
    if "stand on points" in words:
        return _two_points(urdf, column, seed)
    if "no posture in which it stands" in words:
        return _standing(urdf, column, seed, count)
    return Look("not decided", "nothing was proposed that could be looked at")


def _standing(urdf: Path, column: str, seed: int, count: int) -> Look:
    """A robot with legs and toes but no posture: on all its limbs, and with its hands on walls."""
    subject = subject_of_robot(
        prepare_detected_legs(detect_legs(urdf)).draft.load_robot(meshes=True)
    )
    ways = [replace(subject, on_walls=(False,) * len(subject.on_walls))]
    if column in ("ground", "stairs") and any(subject.on_walls):
        ways.append(subject)
    return all_right([_looked(way, column, seed, count) for way in ways])


def _looked(subject: Subject, column: str, seed: int, count: int) -> Look:
    look = second_look(subject, column, seed, count)
    if not any(subject.on_walls):
        return look
    return replace(look, words=f"with hands on walls {look.words}")


def all_right(looks: list[Look]) -> Look:
    """Of several ways to do the same: right where none of them can be."""
    words = "; ".join(look.words for look in looks)
    verdicts = {look.verdict for look in looks}
    told = "not borne out" if "not borne out" in verdicts else "not decided"
    verdict = verdicts.pop() if len(verdicts) == 1 else told
    return Look(verdict, words, sum(x.reached for x in looks), sum(x.drawn for x in looks))


def _two_points(urdf: Path, column: str, seed: int) -> Look:
    """Two legs that end in points: how far the weight is beside the one that stands."""
    if column not in CLIMBS:
        return Look("limit of ours", "walks are of four, six or eight legs")
    tree = read_tree(urdf)
    pin, rng = import_pinocchio(), np.random.default_rng(seed)
    model = pin.buildModelFromUrdf(str(urdf))
    data = model.createData()
    nearest = np.inf
    ends = [
        int(model.getFrameId(limb.end)) for limb in find_limbs(tree, find_body_link(tree)).limbs
    ]
    low, high = (
        np.maximum(model.lowerPositionLimit, -np.pi),
        np.minimum(model.upperPositionLimit, np.pi),
    )
    for _ in range(_DRAWN):
        q = rng.uniform(low, high)
        middle = pin.centerOfMass(model, data, q)
        pin.framesForwardKinematics(model, data, q)
        off = [np.linalg.norm((data.oMf[end].translation - middle)[:2]) for end in ends]
        nearest = min(nearest, float(min(off)))
    words = (
        f"with one leg lifted the other holds the robot where its centre of mass is above one "
        f"point, and nowhere else: of {_DRAWN} postures drawn it is {1e3 * nearest:.1f} mm beside "
        "it in the nearest"
    )
    return Look("refusal right", words, 0, _DRAWN)
