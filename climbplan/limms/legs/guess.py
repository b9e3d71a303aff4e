"""Slow initial guesses of a quadruped's motion along a corridor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.gaits import SwingPattern, compute_centre_path, compute_nominal_feet
from climbplan.limms.legs.leaps import Leap
from climbplan.limms.legs.leg_phases import CONTROLS, LegPhase, LegTrajectory
from climbplan.limms.modules.limbs import compute_limb_angles
from climbplan.limms.motion.cubics import BoxPath
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import GRAVITY, ModuleScene
from climbplan.limms.scene.phases import SupportModule

SPEED = 0.3  # [m/s] of the box
KNOTS = 6  # intervals of a stance
WALK_KNOTS = 3  # intervals of a phase of a walk


def build_leg_guess(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    gait: SwingPattern,
    corridor: Corridor,
    ends: tuple[Array, Array],
    first: tuple[Array, Sequence[int]],
) -> list[LegTrajectory]:
    """Build a slow motion of a contact sequence, with swing feet moved to nominal footholds.

    Args:
        scene: The scene.
        limbs: The legs.
        gait: The contact sequence.
        corridor: The corridor of the box.
        ends: Start and goal of the box (3,) [m].
        first: Footholds (L, 3) [m] and their patches.
    """
    num_limbs = len(limbs)
    corners = compute_centre_path(scene, gait, corridor, *ends)
    feet, patches = first[0].copy(), list(first[1])
    trajectories: list[LegTrajectory] = []
    for index, swing in enumerate(gait.swings):
        start, end = corners[index], corners[index + 1]
        is_leap = len(swing) == num_limbs
        after, patches_after = feet.copy(), list(patches)
        if swing:
            later = corners[min(index + 2 * num_limbs, len(corners) - 1)]
            target = end if is_leap else end + 0.5 * (later - end)
            nominal, patches_below = compute_nominal_feet(scene, limbs, target, end[2])
            for i in swing:
                after[i], patches_after[i] = nominal[i], patches_below[i]
        num_intervals = 1 if is_leap else WALK_KNOTS if gait.steps else KNOTS
        length = float(np.linalg.norm(end - start))
        duration = 0.35 if is_leap else max(length / SPEED, 0.35 if not swing else 0.6)
        fractions = np.linspace(0, 1, num_intervals + 1)[:, None]
        controls = _interpolate_swings(scene, limbs, swing, (start, end), (feet, after))
        force = _share_weight(scene, num_intervals, num_limbs, swing)
        acceleration = np.zeros((num_intervals + 1, 3))
        velocity = np.tile((end - start) / duration, (num_intervals + 1, 1))
        if is_leap:
            acceleration[:, 2] = -GRAVITY
        block = _select_block(corridor, start, end)
        phase = _build_phase(block, num_intervals, swing, patches_after)
        trajectories.append(
            LegTrajectory(
                phase,
                duration,
                start + fractions * (end - start),
                velocity,
                acceleration,
                feet.copy(),
                after,
                controls,
                force,
            )
        )
        feet, patches = after, patches_after
    return trajectories


def _build_phase(
    block: Array, num_intervals: int, swing: tuple[int, ...], patches: Sequence[int]
) -> LegPhase:
    """Build a flight, a step or a stance in a free block.

    Args:
        block: Lower and upper corner of the block (2, 3) [m].
        num_intervals: Number of intervals.
        swing: The legs in swing.
        patches: Patches of all feet at the end of the phase.
    """
    is_leap = len(swing) == len(patches)
    low, high = block
    limits = (0.08, 1.2) if is_leap else (0.15, 6.0) if swing else (0.05, 8.0)
    return LegPhase(
        "flight" if is_leap else f"step {swing[0]}" if swing else "stance",
        low,
        high,
        num_intervals,
        *limits,
        swing=swing,
        patches=dict(enumerate(patches)),
    )


def _interpolate_swings(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    swing: Sequence[int],
    centres: tuple[Array, Array],
    feet: tuple[Array, Array],
) -> Array:
    """Return control points (L, CONTROLS, 6) on straight lines between the poses of swing legs.

    Args:
        scene: The scene.
        limbs: The legs.
        swing: The legs in swing.
        centres: Centre of the box (3,) at both ends of the phase [m].
        feet: Footholds (L, 3) at both ends [m].
    """
    controls = np.zeros((len(limbs), CONTROLS, 6))
    for i in swing:
        limb = limbs[i]
        end_angles = compute_limb_angles(
            scene, limb, np.stack(centres), np.stack([feet[0][i], feet[1][i]]), limb.branch
        )[0]
        fractions = np.linspace(0, 1, CONTROLS)[:, None]
        controls[i] = end_angles[0] + fractions * (end_angles[1] - end_angles[0])
    return controls


def _share_weight(
    scene: ModuleScene, num_intervals: int, num_limbs: int, swing: Sequence[int]
) -> Array:
    """Return foot forces (K + 1, L, 3) that share the weight of the box evenly [N]."""
    force = np.zeros((num_intervals + 1, num_limbs, 3))
    for i in range(num_limbs):
        if i not in swing:
            force[:, i, 2] = scene.weight / (num_limbs - len(swing))
    return force


def build_leap_guess(
    scene: ModuleScene, leap: Leap, corridor: Corridor, ends: tuple[Array, Array]
) -> list[LegTrajectory]:
    """Build a motion around a leap: crouching, pushing off, flight, landing, coming to rest.

    Args:
        scene: The scene.
        leap: The leap.
        corridor: The corridor of the box.
        ends: Start and goal of the box (3,) [m].
    """
    start, goal = ends
    zero = np.zeros(3)
    arriving = leap.speed - np.array([0, 0, GRAVITY * leap.duration])
    stages = [
        ((start, zero), (leap.takeoff, leap.speed), leap.before, leap.patches[0]),
        ((leap.landing, arriving), (goal, zero), leap.after, leap.patches[1]),
    ]
    trajectories: list[LegTrajectory] = []
    for index, (first, last, feet, patch) in enumerate(stages):
        if index == 1:
            trajectories.append(_build_flight(leap, corridor))
        length = float(np.linalg.norm(last[0] - first[0]))
        speed = float(np.linalg.norm(leap.speed if index == 0 else arriving))
        total = max(2.5 * length / max(speed, 0.1), 0.3)
        # Phases far from the leap and next to it have durations of their own
        stage_fractions = (0.0, 0.6, 1.0) if index == 0 else (0.0, 0.4, 1.0)
        for name, a, b in zip(
            ("stance", "stance"), stage_fractions[:-1], stage_fractions[1:], strict=True
        ):
            fractions = np.linspace(a, b, KNOTS + 1)
            path = _interpolate_hermite(first, last, total, fractions)
            low, high = _select_block(corridor, path.position[0], path.position[-1])
            force = np.zeros((KNOTS + 1, 4, 3))
            force[:, :, 2] = scene.weight / 4
            patches = dict.fromkeys(range(4), patch)
            phase = LegPhase(name, low, high, KNOTS, 0.05, 8.0, patches=patches)
            controls = np.zeros((4, CONTROLS, 6))
            trajectories.append(
                LegTrajectory(phase, total * (b - a), *path, feet, feet, controls, force)
            )
    return trajectories


def _build_flight(leap: Leap, corridor: Corridor) -> LegTrajectory:
    """Return the flight phase of a leap."""
    all_limbs = (0, 1, 2, 3)
    # Over an edge no block contains the flight: cuts exclude its collisions
    low, high = corridor.blocks[:, 0].min(axis=0), corridor.blocks[:, 1].max(axis=0)
    patches = dict.fromkeys(all_limbs, leap.patches[1])
    phase = LegPhase("flight", low, high, 1, 0.08, 1.2, swing=all_limbs, patches=patches)
    fractions = np.linspace(0, 1, CONTROLS)[None, :, None]
    first, last = leap.angles[:, :1], leap.angles[:, 1:]
    gravity = np.array([0, 0, -GRAVITY])
    return LegTrajectory(
        phase,
        leap.duration,
        np.stack([leap.takeoff, leap.landing]),
        np.stack([leap.speed, leap.speed + gravity * leap.duration]),
        np.tile(gravity, (2, 1)),
        leap.before,
        leap.after,
        first + fractions * (last - first),
        np.zeros((2, 4, 3)),
    )


def _interpolate_hermite(
    first: tuple[Array, Array], last: tuple[Array, Array], total: float, fractions: Array
) -> BoxPath:
    """Return a cubic Hermite path between two positions with velocities, in `total` seconds."""
    s = fractions[:, None]
    (p, v), (q, w) = first, last
    acceleration = 6 * (q - p) / total**2 - (4 * v + 2 * w) / total  # acceleration at the start
    slope = (w - v) / total - acceleration  # half of its change
    return BoxPath(
        p + total * s * v + total**2 * s**2 * (acceleration / 2 + slope * s / 3),
        v + total * s * (acceleration + slope * s),
        acceleration + 2 * slope * s,
    )


def _select_block(corridor: Corridor, first: Array, last: Array) -> Array:
    """Return the block that contains both ends of a phase best."""

    def measure_outside(block: Array) -> float:
        return float(
            sum(np.maximum(np.maximum(block[0] - p, p - block[1]), 0).sum() for p in (first, last))
        )

    block_inside: Array = min(corridor.blocks, key=measure_outside)
    return block_inside
