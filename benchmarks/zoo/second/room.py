"""Room for the toes of a walk, in drawn postures: what a refused walk lacks, in mm and N.

A walk at speed stands on two opposite legs of four at a time (of more legs on the three of a
tripod), and its toes go back and forth under the body. Looked for is a posture on level ground in
which every toe reaches the corners of a box about its place, two degrees inside the bounds of its
joints, and holds its part of the weight upright there within torque limits: Newton's method on
Pinocchio's kinematics, and J' f. The size of the box is the least with which planning walks.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from benchmarks.zoo.second.stances import (
    Limbs,
    Stance,
    Surface,
    anywhere,
    beside,
    onto,
    reached,
)
from benchmarks.zoo.second.subject import Subject
from climbplan.arrays import Array

_HALF = np.array([0.02, 0.03, 0.02])  # [m] of the box across, along and up
_KEPT = np.deg2rad(2.0)
_SIZES = tuple(np.linspace(0.1, 1.0, 10))  # of the box, one after another
_TRIPOD = 0.5  # of the weight on the middle leg of a tripod
_MOST, _ABOUT = 20, 1.0  # times as many drawn for those; as many again about the best
_SPREADS = (0.4, 0.03)  # [rad]


@dataclass(frozen=True)
class Room:
    """The best posture that was found."""

    verdict: str
    words: str
    reached: int
    drawn: int


@dataclass(frozen=True)
class _Worth:
    """How near a posture comes: the part of the box that all toes have, or of the force they hold.

    `share` is below 1 where a leg holds only that part of its force, else 1 and that of the box.
    """

    share: float
    words: str


def roomiest(subject: Subject, surfaces: tuple[Surface, ...], seed: int, count: int) -> Room:
    """Draw postures with every toe on the ground, and tell what the best of them lacks."""
    limbs, parts, rng = subject.limbs, subject.parts, np.random.default_rng(seed)
    best: tuple[_Worth, Stance] | None = None
    whole = total = 0
    near = np.inf

    def tried(stance: Stance) -> None:
        nonlocal best, whole, total, near
        total += 1
        near = min(near, stance.missed)
        if stance.missed > 0 or stance.beyond > 0:
            return
        if parts is not None and parts.find_collisions(stance.angles):
            return
        whole += 1
        worth = _worth(limbs, stance)
        if best is None or worth.share > best[0].share:
            best = worth, stance

    if not any(subject.on_walls):
        tried(onto(limbs, surfaces, limbs.found.root_to_base_rotation, subject.standing))
    while whole < count and total < _MOST * count:
        tried(onto(limbs, surfaces, *anywhere(limbs, rng, subject.attitudes)))
    for spread in np.geomspace(*_SPREADS, int(_ABOUT * count)):
        if best is None or best[0].share >= 2:
            break
        tried(onto(limbs, surfaces, *beside(limbs, best[1], spread, rng)))
    if best is None:
        words = f"toes miss level ground by {1e3 * near:.0f} mm or more"
        if near == 0:
            words = "joints are below the ground or parts touch in every posture that was drawn"
        return Room("not decided", words, whole, total)
    if best[0].share >= 2:
        words = (
            "toes have room to step, and legs hold their part of the weight there, in a posture "
            "that was found; speed is no question of postures"
        )
        return Room("not decided", words, whole, total)
    return Room("refusal right", f"at best {best[0].words}", whole, total)


def _worth(limbs: Limbs, stance: Stance) -> _Worth:
    """The least of all legs."""
    q = limbs.placed(stance.turn, stance.angles)
    toes = np.array([limbs.toe(limb)[0] for limb in range(len(limbs.names))])
    center = np.array(limbs.found.library.centerOfMass(limbs.model, limbs.data, q))
    weight = 9.81 * limbs.found.compute_mass()
    part = parts_of_weight(toes - center) * weight
    if (part <= 0).any():
        return _Worth(0.0, "the centre of mass is not between front and rear toes")
    held = np.array([_held(limbs, i, stance.angles) for i in range(len(toes))])
    ratio = held / part
    weakest = int(np.argmin(ratio))
    if ratio[weakest] < 1:
        words = f"{limbs.names[weakest]} holds {held[weakest]:.0f} of {part[weakest]:.0f} N upright"
        return _Worth(float(ratio[weakest]), words)
    least, words = 1.0, ""
    for limb in range(len(toes)):
        size = _size(limbs, limb, stance, toes[limb], float(part[limb]))
        if not words or size < least:
            least = size
            across, along, up = 1e3 * size * _HALF
            words = (
                f"the toe of {limbs.names[limb]} has {along:.0f}, {across:.0f} and {up:.0f} mm "
                f"along, across and up, of {1e3 * _HALF[1]:.0f}, {1e3 * _HALF[0]:.0f} and "
                f"{1e3 * _HALF[2]:.0f}, where its leg holds {part[limb]:.0f} N"
            )
    return _Worth(1.0 + least, words)


def parts_of_weight(toes: Array) -> Array:
    """(N,) of the weight that toes (N, 3), seen from the centre of mass, bear at most.

    Of four legs front and rear ones share a diagonal as a lever does.
    """
    if len(toes) != 4:
        return np.full(len(toes), _TRIPOD)
    order = np.argsort(toes[:, 1])
    rear, front = order[:2], order[2:]
    behind, ahead = -float(toes[rear, 1].mean()), float(toes[front, 1].mean())
    out = np.zeros(4)
    if behind > 0 and ahead > 0:
        out[front], out[rear] = behind / (behind + ahead), ahead / (behind + ahead)
    return out


def _held(limbs: Limbs, limb: int, angles: dict[str, float]) -> float:
    """Largest upright force [N] of a limb where the robot was placed."""
    upward = np.abs(limbs.toe(limb)[1][2, limbs.columns[limb]])
    return float((limbs.torque[limb] / np.maximum(upward, 1e-9)).min())


def _size(limbs: Limbs, limb: int, stance: Stance, toe: Array, force: float) -> float:
    """The part of the box that a leg reaches and is strong enough in."""
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * _HALF
    had = 0.0
    for size in _SIZES:
        for corner in corners:
            goal = {limb: toe + size * corner}
            angles = reached(limbs, goal, stance.turn, stance.at, stance.angles, _KEPT)
            if angles is None:
                return had
            limbs.placed(stance.turn, angles)
            if _held(limbs, limb, angles) < force:
                return had
        had = size
    return had
