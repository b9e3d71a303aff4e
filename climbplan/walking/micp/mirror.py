"""Motions and their mirror images: of two that differ in nothing but left and right, one is enough.

Where a task is its own mirror image and so is the tube, the image of each motion costs the same and
is in the tube, too. A bound of motions whose first contact without its image is a left leg's then
is one of all of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.model import Lin, total
from climbplan.walking.micp.statement import Relaxation
from climbplan.walking.micp.tube import Tube
from climbplan.walking.task.task import WalkTask

_LENGTHS = np.array([1.0, -1.0, 1.0])  # of the image, across the plane of x and z
_TURNS = -_LENGTHS
_STATE = np.concatenate([_LENGTHS, _LENGTHS, _TURNS, _TURNS])
_NEAR = 0.1  # of the room about motions, that a tube is widened by for its image
_PAIRS = 8  # of legs that are compared: each weighs half of the one before


def own_image(task: WalkTask) -> bool:
    """Whether the image of each motion costs the same and keeps the same rows."""
    body, ground, reference, goal = task.body, task.ground, task.reference, task.goal
    swapped = np.arange(body.leg_count) ^ 1  # legs are in pairs, the left one first
    alike = (
        (body.toe_center, body.toe_center[swapped] * _LENGTHS),
        (body.inertia, body.inertia * np.outer(_LENGTHS, _LENGTHS)),
        (ground.lower[:, 1], -ground.upper[:, 1]),
        (task.start.state, task.start.state * _STATE),
        (task.start.toes, task.start.toes[swapped] * _LENGTHS),
        (reference.velocity, reference.velocity * _LENGTHS),
        (reference.euler, reference.euler * _TURNS),
        (goal.lower[1], -goal.upper[1]),
    )
    return all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in alike)


def with_images(tube: Tube, angles: Array, spin: Array) -> Tube | None:
    """A tube that also holds the images of its motions; None if it had to be much wider.

    angles, spin: (3,) room about the motions.
    """
    off, off_spin = (np.where(_TURNS < 0, middle, 0.0) for middle in (tube.angles, tube.spin))
    if (np.abs(off) > _NEAR * angles).any() or (np.abs(off_spin[:-1]) > _NEAR * spin).any():
        return None
    return replace(
        tube,
        angles=tube.angles - off,
        angles_half=tube.angles_half + np.abs(off),
        spin=tube.spin - off_spin,
        spin_half=tube.spin_half + np.abs(off_spin),
        heading=tube.heading - off[:, 2],
    )


def left_first(program: Relaxation) -> Lin:
    """An expression that is 0 or more where the first leg that stands without its image is left."""
    stands = [total(q.chosen for q in leg) for legs in program.pieces for leg in legs]
    pairs = list(zip(stands[::2], stands[1::2], strict=True))[:_PAIRS]
    return total((left - right) * 0.5**k for k, (left, right) in enumerate(pairs))
