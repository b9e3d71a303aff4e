"""Postures of a robot on surfaces, drawn at random: joint angles first, then toes onto them.

Pinocchio and nothing else: neither the grids of toes nor the inverse kinematics with which postures
are proposed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.robots.urdf.pinocchio_model import UrdfModel

_STEPS = 25  # of Newton's method on one coordinate of a toe
_NEAR = 1e-6  # [m] off its surface, at which a toe is on it
_TILT = 0.25  # [rad] of the body at most, in every second sample
_FULL = np.pi  # [rad] that joints turn at most
_FLAT = 1e-12  # [m/rad]^2, below which no joint moves a toe towards its surface
_FOUND = 30  # steps of damped Newton on whole toes
_DAMPED = 1e-6  # [m^2/rad^2]
_TURN = 0.5  # [rad] that a joint turns at most in one step


@dataclass(frozen=True)
class Surface:
    """Where a toe has to be, in the frame x right, y forward, z up."""

    axis: int  # its normal: 0 a wall, 2 the ground
    side: float  # of the body on which it is
    raised: float = 0.0  # [m] above others of its kind: a stair


@dataclass(frozen=True)
class Stance:
    """A posture with every toe on its surface, or short of it."""

    turn: Array  # (3, 3) of the root link
    angles: dict[str, float]  # [rad] by joint
    missed: float  # [m] by which the toe farthest from its surface is off
    beyond: float = 0.0  # [m] by which a joint is outside a wall or below the ground
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the root [m]


class Limbs:
    """A robot in Pinocchio's hands, limb by limb."""

    def __init__(self, found: UrdfModel, limits: dict[str, float]) -> None:
        """limits: torque by joint [N m]."""
        pin, self.model, robot = found.library, found.model, found.robot
        self.found, self.data = found, found.model.createData()
        self.names = robot.limb_names
        self.joints = [robot.joints[name] for name in self.names]
        legs = [robot.spec.legs[name] for name in self.names]
        self.frames = [int(self.model.getFrameId(leg.toe, pin.FrameType.BODY)) for leg in legs]
        self.offsets = [np.array(leg.toe_offset, float) for leg in legs]
        self.columns: list[IntArray] = [
            np.array([self.model.idx_vs[self.model.getJointId(j.name)] for j in own], np.int64)
            for own in self.joints
        ]
        self.moving = [self.model.getJointId(j.name) for own in self.joints for j in own]
        self.torque = [np.array([limits[j.name] for j in own]) for own in self.joints]
        chains = [found.read_leg(name) for name in self.names]
        self.hips = np.array([leg.joints[0] for leg in chains])  # (N, 3) [m]
        ends = [np.concatenate([leg.joints, leg.toe[None]]) for leg in chains]
        lengths = [np.linalg.norm(np.diff(own, axis=0), axis=1).sum() for own in ends]
        self.lengths = np.array(lengths)  # (N,) [m] from first joint to toe, stretched out

    def placed(
        self, turn: Array, angles: dict[str, float], at: tuple[float, float, float] = (0, 0, 0)
    ) -> Any:
        """Pinocchio's coordinates, with the root's origin `at` [m]; Jacobians are made ready."""
        pin = self.found.library
        q = self.found.build_configuration(angles)
        q[:3] = at
        q[3:7] = pin.Quaternion(turn).coeffs()
        pin.computeJointJacobians(self.model, self.data, q)
        return q

    def toe(self, limb: int) -> tuple[Array, Array]:
        """Toe (3,) [m] and the Jacobian (3, nv) of its velocity, where the robot was placed."""
        pin = self.found.library
        place = pin.updateFramePlacement(self.model, self.data, self.frames[limb])
        arm = place.rotation @ self.offsets[limb]
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        full = pin.getFrameJacobian(self.model, self.data, self.frames[limb], aligned)
        x, y, z = arm
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return place.translation + arm, full[:3] - cross @ full[3:]


def anywhere(
    limbs: Limbs, rng: np.random.Generator, attitudes: int = 1
) -> tuple[Array, dict[str, float]]:
    """Any turn of the root, level in half of the samples, and any angles.

    attitudes: 3 to draw the body also pitched by a right angle, front or back down.
    """
    pin = limbs.found.library
    tilt = rng.uniform(-_TILT, _TILT, size=2) if rng.random() < 0.5 else np.zeros(2)
    pitch = (0.0, -np.pi / 2, np.pi / 2)[int(rng.integers(attitudes))]
    lying = pin.exp3(np.array([pitch, 0.0, 0.0])) @ limbs.found.root_to_base_rotation
    turn = pin.exp3(np.array([tilt[0], tilt[1], 0.0])) @ lying
    angles = {
        joint.name: float(rng.uniform(max(joint.lower, -_FULL), min(joint.upper, _FULL)))
        for own in limbs.joints
        for joint in own
    }
    return turn, angles


def beside(
    limbs: Limbs, stance: Stance, spread: float, rng: np.random.Generator
) -> tuple[Array, dict[str, float]]:
    """A turn and angles within some `spread` [rad] of a stance."""
    pin = limbs.found.library
    tilt = spread * rng.uniform(-0.3, 0.3, size=2)
    turn = pin.exp3(np.array([tilt[0], tilt[1], 0.0])) @ stance.turn
    angles = {
        joint.name: float(
            np.clip(
                stance.angles[joint.name] + rng.uniform(-spread, spread),
                max(joint.lower, -_FULL),
                min(joint.upper, _FULL),
            )
        )
        for own in limbs.joints
        for joint in own
    }
    return turn, angles


def onto(
    limbs: Limbs, surfaces: tuple[Surface, ...], turn: Array, angles: dict[str, float]
) -> Stance:
    """Toes moved onto surfaces that lie where the toes are on average, walls outside the hips."""
    angles = dict(angles)
    limbs.placed(turn, angles)
    toes = np.array([limbs.toe(limb)[0] for limb in range(len(limbs.names))])
    kinds = {(s.axis, s.side) for s in surfaces}
    level = {}
    for kind in kinds:
        own = [i for i, s in enumerate(surfaces) if (s.axis, s.side) == kind]
        raised = np.array([surfaces[i].raised for i in own])
        level[kind] = float((toes[own, kind[0]] - raised).mean())
        if kind[0] == 0:
            least = float((kind[1] * limbs.hips[:, 0]).max())
            level[kind] = kind[1] * max(kind[1] * level[kind], least)
    missed = 0.0
    for limb, surface in enumerate(surfaces):
        goal = level[surface.axis, surface.side] + surface.raised
        missed = max(missed, _moved(limbs, limb, surface.axis, goal, turn, angles))
    limbs.placed(turn, angles)
    joints = np.array([limbs.data.oMi[k].translation for k in limbs.moving])
    beyond = max(float((side * (joints[:, axis] - at)).max()) for (axis, side), at in level.items())
    return Stance(turn, angles, missed if missed > _NEAR else 0.0, max(beyond, 0.0))


def reached(
    limbs: Limbs,
    goals: dict[int, Array],
    turn: Array,
    at: tuple[float, float, float],
    angles: dict[str, float],
    kept: float = 0.0,
) -> dict[str, float] | None:
    """Angles with which limbs have their toes at points (3,), by damped Newton from `angles`.

    kept: [rad] from the bounds of joints. None where a toe does not get there.
    """
    angles = dict(angles)
    for _ in range(_FOUND):
        limbs.placed(turn, angles, at)
        worst = 0.0
        for limb, goal in goals.items():
            toe, jacobian = limbs.toe(limb)
            off = goal - toe
            worst = max(worst, float(np.abs(off).max()))
            own = jacobian[:, limbs.columns[limb]]
            step = own.T @ np.linalg.solve(own @ own.T + _DAMPED * np.eye(3), off)
            for joint, turned in zip(limbs.joints[limb], step, strict=True):
                moved = angles[joint.name] + float(np.clip(turned, -_TURN, _TURN))
                low, high = max(joint.lower, -_FULL) + kept, min(joint.upper, _FULL) - kept
                angles[joint.name] = min(max(moved, low), high)
        if worst < _NEAR:
            return angles
    return None


def _moved(
    limbs: Limbs, limb: int, axis: int, goal: float, turn: Array, angles: dict[str, float]
) -> float:
    """Newton's method on one coordinate of a toe, in the limb's own angles; how far it is off."""
    off = np.inf
    for _ in range(_STEPS):
        limbs.placed(turn, angles)
        toe, jacobian = limbs.toe(limb)
        off = goal - float(toe[axis])
        row = jacobian[axis, limbs.columns[limb]]
        square = float(row @ row)
        if abs(off) < _NEAR or square < _FLAT:
            break
        for joint, step in zip(limbs.joints[limb], row * (off / square), strict=True):
            moved = angles[joint.name] + float(np.clip(step, -0.5, 0.5))
            angles[joint.name] = min(max(moved, joint.lower, -_FULL), joint.upper, _FULL)
    return abs(off)
