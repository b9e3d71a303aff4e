"""A quadruped's motion between its knots: exact cubics, legs in closed form, splines in the air."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.joint_splines import spline_rates, spline_weights
from climbplan.limms.legs.statement import LegTrace
from climbplan.limms.modules.chain import from_last, inverse
from climbplan.limms.modules.limbs import limb_frames, limb_points
from climbplan.limms.motion.cubics import BoxPath, box_path, knot_samples
from climbplan.limms.motion.straight_ways import rates_of
from climbplan.limms.scene.limms_scene import Points, Pose, Scene
from climbplan.limms.scene.phases import Limb


@dataclass(frozen=True)
class LegMotion:
    """A phase at times (n,); L limbs."""

    time: Array  # (n,) [s]
    box: BoxPath
    angles: Array  # (n, L, 6) [rad], without jumps
    rates: Array  # (n, L, 6) [rad/s]
    feet: Array  # (n, L, 3) first ends [m]
    missing: Array  # (n, L) by how much a foothold is out of reach [m]
    points: tuple[Points, ...]  # of each limb


def leg_motion(
    scene: Scene,
    limbs: Sequence[Limb],
    trace: LegTrace,
    now: Array | None = None,
    finer: int = 1,
) -> LegMotion:
    """All of a phase at most 10 ms apart.

    now: (L, 6) joint angles when it begins, whose whole turns are kept [rad]; finer: how
    many times as dense as that.
    """
    phase = trace.phase
    time = knot_samples(trace.duration, phase.intervals, finer)
    box = box_path(trace.duration, trace.position, trace.velocity, trace.acceleration, time)
    n = len(limbs)
    angles, rates = np.zeros((len(time), n, 6)), np.zeros((len(time), n, 6))
    feet, missing = np.zeros((len(time), n, 3)), np.zeros((len(time), n))
    points = []
    for i, limb in enumerate(limbs):
        if i in phase.swing:
            ends = box.position[[0, -1]], np.stack([trace.before[i], trace.after[i]])
            own, missing[[0, -1], i] = _standing(scene, limb, *ends)
            controls = trace.controls[i].copy()
            for j in (0, -1):  # exactly where the leg stood and will stand, whole turns as planned
                controls[j] = own[j] + _turns(controls[j] - own[j])
            if now is not None:
                controls = controls + _turns(now[i] - controls[0])
            shares = time / trace.duration
            angles[:, i] = spline_weights(len(controls), shares) @ controls
            rates[:, i] = spline_rates(controls, shares) / trace.duration
            shape = (len(time), 3, 3)
            tip = box.position + scene.side_offset(0, limb.side)
            last = Pose(tip, np.broadcast_to(limb.box_rotation, shape))
            points.append(from_last(scene.module, last, angles[:, i]))
            feet[:, i] = points[i].position[:, 0]
        else:
            feet[:, i] = trace.before[i]
            own, missing[:, i] = _standing(scene, limb, box.position, feet[:, i])
            own = np.unwrap(own, axis=0)
            if now is not None:
                own = own + _turns(now[i] - own[0])
            angles[:, i], rates[:, i] = own, rates_of(time, own)
            points.append(limb_points(scene, limb, box.position, feet[:, i], own))
    return LegMotion(time, box, angles, rates, feet, missing, tuple(points))


def _turns(difference: Array) -> Array:
    """The whole turns nearest to differences of angles."""
    turns: Array = np.round(difference / (2 * np.pi)) * 2 * np.pi
    return turns


def _standing(scene: Scene, limb: Limb, box: Array, feet: Array) -> tuple[Array, Array]:
    """Angles (n, 6) of a leg, and missing reach (n)."""
    first, last = limb_frames(scene, limb, box, feet)
    shape = (len(box), 3, 3)
    return inverse(
        scene.module,
        Pose(first.position, np.broadcast_to(first.rotation, shape)),
        Pose(last.position, np.broadcast_to(last.rotation, shape)),
        limb.branch,
    )
