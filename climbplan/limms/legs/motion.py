"""A quadruped's motion between its knots: exact cubics, closed-form legs, splines in swing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.joint_splines import compute_spline_rates, compute_spline_weights
from climbplan.limms.legs.leg_phases import LegTrajectory
from climbplan.limms.modules.chain import forward_from_last, solve_inverse_kinematics
from climbplan.limms.modules.limbs import compute_limb_frames, compute_limb_points
from climbplan.limms.motion.cubics import BoxPath, evaluate_box_path, sample_knots
from climbplan.limms.motion.straight_motion import compute_rates
from climbplan.limms.scene.limms_scene import FramePoses, ModuleScene, Points
from climbplan.limms.scene.phases import SupportModule


@dataclass(frozen=True)
class LegMotion:
    """A phase at times (n,) of L limbs."""

    time: Array  # (n,) [s]
    box: BoxPath
    angles: Array  # (n, L, 6) [rad], without jumps
    rates: Array  # (n, L, 6) [rad/s]
    feet: Array  # (n, L, 3) first ends [m]
    reach_error: Array  # (n, L) missing reach to footholds [m]
    points: tuple[Points, ...]  # of each limb


def compute_leg_motion(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    trajectory: LegTrajectory,
    current: Array | None = None,
    finer: int = 1,
) -> LegMotion:
    """Compute a phase at most 10 ms apart.

    Args:
        scene: The scene.
        limbs: The legs.
        trajectory: The phase.
        current: Joint angles (L, 6) at the start, whose full turns are kept [rad]; None for any.
        finer: Factor of the density.
    """
    phase = trajectory.phase
    time = sample_knots(trajectory.duration, phase.intervals, finer)
    box = evaluate_box_path(
        trajectory.duration, trajectory.position, trajectory.velocity, trajectory.acceleration, time
    )
    num_limbs = len(limbs)
    angles, rates = np.zeros((len(time), num_limbs, 6)), np.zeros((len(time), num_limbs, 6))
    feet, reach_error = np.zeros((len(time), num_limbs, 3)), np.zeros((len(time), num_limbs))
    points = []
    for i, limb in enumerate(limbs):
        if i in phase.swing:
            ends = box.position[[0, -1]], np.stack([trajectory.before[i], trajectory.after[i]])
            solved, reach_error[[0, -1], i] = _solve_standing(scene, limb, *ends)
            controls = trajectory.controls[i].copy()
            for j in (0, -1):  # exact poses of the stances, with planned full turns
                controls[j] = solved[j] + _round_to_turns(controls[j] - solved[j])
            if current is not None:
                controls = controls + _round_to_turns(current[i] - controls[0])
            fractions = time / trajectory.duration
            angles[:, i] = compute_spline_weights(len(controls), fractions) @ controls
            rates[:, i] = compute_spline_rates(controls, fractions) / trajectory.duration
            shape = (len(time), 3, 3)
            tip = box.position + scene.side_offset(0, limb.side)
            last = FramePoses(tip, np.broadcast_to(limb.box_rotation, shape))
            points.append(forward_from_last(scene.module, last, angles[:, i]))
            feet[:, i] = points[i].position[:, 0]
        else:
            feet[:, i] = trajectory.before[i]
            solved, reach_error[:, i] = _solve_standing(scene, limb, box.position, feet[:, i])
            solved = np.unwrap(solved, axis=0)
            if current is not None:
                solved = solved + _round_to_turns(current[i] - solved[0])
            angles[:, i], rates[:, i] = solved, compute_rates(time, solved)
            points.append(compute_limb_points(scene, limb, box.position, feet[:, i], solved))
    return LegMotion(time, box, angles, rates, feet, reach_error, tuple(points))


def _round_to_turns(difference: Array) -> Array:
    """Return the full turns nearest to differences of angles [rad]."""
    turns: Array = np.round(difference / (2 * np.pi)) * 2 * np.pi
    return turns


def _solve_standing(
    scene: ModuleScene, limb: SupportModule, box: Array, feet: Array
) -> tuple[Array, Array]:
    """Return angles (n, 6) of a leg, and missing reach (n,) [m]."""
    first, last = compute_limb_frames(scene, limb, box, feet)
    shape = (len(box), 3, 3)
    return solve_inverse_kinematics(
        scene.module,
        FramePoses(first.position, np.broadcast_to(first.rotation, shape)),
        FramePoses(last.position, np.broadcast_to(last.rotation, shape)),
        limb.branch,
    )
