"""Which envelopes a climb is planned with: learned ones that ship, a file's, or the expert's.

Envelopes are learned for some limbs that stand (`envelopes/terrains.py`). A limb beyond these takes
the mirror image of the one opposite; a robot of other limbs has the expert's, on ground and braced.
With N limbs on the ground instead of the n of the training, forces that balance are means of
balances of n, so the box of forces shrinks by n / N.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.climb.coupled.statement import compute_force_range
from climbplan.climb.envelopes.file import StoredEnvelopes, read_envelopes
from climbplan.climb.envelopes.legs import POSITION_SCALE
from climbplan.climb.envelopes.shipped import PREFERENCE, SHIPPED, read_shipped_envelopes
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import UsageError
from climbplan.learning.envelope_box import Envelope
from climbplan.robots.model import Robot

EXPERT, EXPERT_GROUND = "expert", "expert-ground"
_TILT = float(np.cos(np.deg2rad(30.0)))  # of normals from the nominal one, as in the training

_TOE = 0.35  # [m] a toe's range about its stance along each axis, of the expert
_SHEAR = 0.3
_MAX_LOAD = 0.5


@dataclass(frozen=True)
class NamedEnvelope:
    """The box of all N limbs and where it is from."""

    name: str  # as the spec names it
    fit: str  # method that it was fitted by
    box: Envelope  # (N, 6) toe about the point of reference [P], force [weights]


def select_envelopes(scene: ClimbScene, several: bool = False) -> tuple[NamedEnvelope, ...]:
    """Select the envelopes that the spec names, or by the terrain: one, or ground and wall."""
    names = scene.spec.solver.envelopes
    if not names:
        names = _modes(scene) if several else (_by_terrain(scene),)
    return tuple(load_envelope(scene, name) for name in names)


def load_envelope(scene: ClimbScene, name: str) -> NamedEnvelope:
    """Load a shipped envelope, an expert's, or one of a file; raise UsageError for others.

    name: a shipped one may be followed by the method of the fit, `wall5:genetic`.
    """
    if name in (EXPERT, EXPERT_GROUND):
        box = braced_envelope(scene) if name == EXPERT else ground_envelope(scene)
        return NamedEnvelope(name, "expert", box)
    shipped, _, fit = name.partition(":")
    if shipped in SHIPPED:
        stored = read_shipped_envelopes(shipped)
    elif Path(name).is_file():
        stored, fit = read_envelopes(Path(name)), ""
    else:
        known_names = ", ".join((*SHIPPED, EXPERT, EXPERT_GROUND))
        raise UsageError(f"unknown envelope {name!r}: expected one of {known_names}, or a file")
    fits = (fit,) if fit else PREFERENCE
    method = next((m for m in fits if m in stored.envelopes), None)
    if method is None:
        available = ", ".join(stored.envelopes) or "none"
        raise UsageError(f"envelope {name!r}: no such fit, there are {available}")
    return NamedEnvelope(name, method, extend_envelope(scene, stored, stored.envelopes[method]))


def extend_envelope(scene: ClimbScene, stored: StoredEnvelopes, envelope: Envelope) -> Envelope:
    """Extend an envelope to all limbs of the scene's robot, with the force bounds of P."""
    robot = scene.robot
    if not set(stored.limb_names) <= set(robot.limb_names):
        theirs, own_names = ", ".join(stored.limb_names), ", ".join(robot.limb_names)
        raise UsageError(
            f"envelopes of {theirs} do not fit {robot.name}, whose limbs are {own_names}; expected "
            f"`{EXPERT}`, `{EXPERT_GROUND}`, or a file that `fit-envelopes` wrote for them"
        )
    scale = np.array([stored.position_scale / POSITION_SCALE] * 3 + [1.0] * 3)
    lower, upper = envelope.lower * scale, envelope.upper * scale
    low, high = np.empty((robot.limb_count, 6)), np.empty((robot.limb_count, 6))
    for limb, name in enumerate(robot.limb_names):
        if name in stored.limb_names:
            k = stored.limb_names.index(name)
            low[limb], high[limb] = lower[k], upper[k]
            continue
        opposite_limb = robot.limb_names[opposite(robot, limb)]
        if opposite_limb not in stored.limb_names:
            raise UsageError(
                f"envelopes of {', '.join(stored.limb_names)} do not include limb {name}"
            )
        k = stored.limb_names.index(opposite_limb)
        mirrored = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, 1.0])  # mirrored at x = 0
        ends = np.stack([lower[k] * mirrored, upper[k] * mirrored])
        low[limb], high[limb] = ends.min(axis=0), ends.max(axis=0)
    fraction = len(stored.limb_names) / robot.limb_count
    low[:, 3:] *= fraction
    high[:, 3:] *= fraction
    force_bounds = compute_force_range(scene)
    low[:, 3:] = np.clip(low[:, 3:], force_bounds.lower, force_bounds.upper)
    high[:, 3:] = np.clip(high[:, 3:], force_bounds.lower, force_bounds.upper)
    return Envelope(low, high)


def opposite(robot: Robot, limb: int) -> int:
    """The limb whose shoulder is the mirror image."""
    mirrored = robot.shoulder_body[limb] * [-1.0, 1.0, 1.0]
    return int(np.argmin(np.linalg.norm(robot.shoulder_body - mirrored, axis=1)))


def _by_terrain(scene: ClimbScene) -> str:
    """ground3 or wall5 where the robot has their limbs and all regions are tilted as in their
    training, else the expert's."""
    robot, terrain = scene.robot, scene.terrain
    side = np.sign(robot.shoulder_body[:, 0])
    for name, nominal in (
        ("ground3", np.tile([0.0, 0.0, 1.0], (robot.limb_count, 1))),
        ("wall5", -side[:, None] * [1.0, 0.0, 0.0]),
    ):
        level = nominal @ np.stack([region.normal for region in terrain.regions]).T
        if _has_limbs(robot, name) and (level[terrain.allowed] >= _TILT).all():
            return name
    return EXPERT


def _modes(scene: ClimbScene) -> tuple[str, ...]:
    """Ground and wall: the shipped ones where the robot has their limbs, else the expert's."""
    shipped = ("ground3", "wall5")
    fit = all(_has_limbs(scene.robot, name) for name in shipped)
    return shipped if fit else (EXPERT_GROUND, EXPERT)


def _has_limbs(robot: Robot, name: str) -> bool:
    return set(read_shipped_envelopes(name).limb_names) <= set(robot.limb_names)


def braced_envelope(scene: ClimbScene) -> Envelope:
    """The expert's bounds for a robot between walls, each limb carrying some of the weight."""
    return _expert(scene, float(compute_force_range(scene).upper[0]))


def ground_envelope(scene: ClimbScene) -> Envelope:
    """The expert's bounds on ground, where no limb pushes aside by more than friction asks for."""
    return _expert(scene, _SHEAR)


def _expert(scene: ClimbScene, lateral: float) -> Envelope:
    """across: most force of a limb along x [weights]."""
    stance = scene.robot.stance_body / POSITION_SCALE
    reach, force_bounds = _TOE / POSITION_SCALE, compute_force_range(scene)
    force = np.array([lateral, _SHEAR, 0.0])
    low, high = np.tile(-force, (len(stance), 1)), np.tile(force, (len(stance), 1))
    low[:, 2], high[:, 2] = force_bounds.lower[2], _MAX_LOAD
    return Envelope(np.hstack([stance - reach, low]), np.hstack([stance + reach, high]))
