"""Slow guesses of a quadruped's motion along a way, from which its program starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.gaits import Gait, centre_path, nominal_feet
from climbplan.limms.legs.leaps import Leap
from climbplan.limms.legs.statement import CONTROLS, LegPhase, LegTrace
from climbplan.limms.modules.limbs import limb_angles
from climbplan.limms.motion.cubics import BoxPath
from climbplan.limms.scene.corridor import Corridor
from climbplan.limms.scene.limms_scene import GRAVITY, Scene
from climbplan.limms.scene.phases import Limb

SPEED = 0.3  # [m/s] of the box
KNOTS = 6  # intervals of a stance
WALK_KNOTS = 3  # intervals of a phase of a walk


def leg_guess(
    scene: Scene,
    limbs: Sequence[Limb],
    gait: Gait,
    way: Corridor,
    ends: tuple[Array, Array],
    first: tuple[Array, Sequence[int]],
) -> list[LegTrace]:
    """A slow motion of a contact sequence along a way, feet moved to nominal places on the way.

    ends: (3,) start and goal of the box [m]; first: footholds (L, 3) [m] and their patches.
    """
    n = len(limbs)
    corners = centre_path(scene, gait, way, *ends)
    feet, patches = first[0].copy(), list(first[1])
    traces: list[LegTrace] = []
    for number, swing in enumerate(gait.swings):
        begin, end = corners[number], corners[number + 1]
        leap = len(swing) == n
        after, ground = feet.copy(), list(patches)
        if swing:
            ahead = corners[min(number + 2 * n, len(corners) - 1)]
            aim = end if leap else end + 0.5 * (ahead - end)
            wanted, under = nominal_feet(scene, limbs, aim, end[2])
            for i in swing:
                after[i], ground[i] = wanted[i], under[i]
        count = 1 if leap else WALK_KNOTS if gait.steps else KNOTS
        length = float(np.linalg.norm(end - begin))
        duration = 0.35 if leap else max(length / SPEED, 0.35 if not swing else 0.6)
        share = np.linspace(0, 1, count + 1)[:, None]
        controls = np.zeros((n, CONTROLS, 6))
        for i in swing:
            limb = limbs[i]
            both = limb_angles(
                scene, limb, np.stack([begin, end]), np.stack([feet[i], after[i]]), limb.branch
            )[0]
            shares = np.linspace(0, 1, CONTROLS)[:, None]
            controls[i] = both[0] + shares * (both[1] - both[0])
        force = np.zeros((count + 1, n, 3))
        for i in range(n):
            if i not in swing:
                force[:, i, 2] = scene.weight / (n - len(swing))
        acceleration = np.zeros((count + 1, 3))
        velocity = np.tile((end - begin) / duration, (count + 1, 1))
        if leap:
            acceleration[:, 2] = -GRAVITY
        low, high = _block_for(way, begin, end)
        limits = (0.08, 1.2) if leap else (0.15, 6.0) if swing else (0.05, 8.0)
        phase = LegPhase(
            "flight" if leap else f"step {swing[0]}" if swing else "stance",
            low,
            high,
            count,
            *limits,
            swing=swing,
            patches=dict(enumerate(ground)),
        )
        traces.append(
            LegTrace(
                phase,
                duration,
                begin + share * (end - begin),
                velocity,
                acceleration,
                feet.copy(),
                after,
                controls,
                force,
            )
        )
        feet, patches = after, ground
    return traces


def leap_guess(
    scene: Scene, leap: Leap, way: Corridor, ends: tuple[Array, Array]
) -> list[LegTrace]:
    """A motion round a leap: crouching and pushing off, the flight, landing and coming to rest.

    ends: (3,) start and goal of the box [m].
    """
    start, goal = ends
    still = np.zeros(3)
    arriving = leap.speed - np.array([0, 0, GRAVITY * leap.duration])
    stages = [
        ((start, still), (leap.takeoff, leap.speed), leap.before, leap.patches[0]),
        ((leap.landing, arriving), (goal, still), leap.after, leap.patches[1]),
    ]
    traces: list[LegTrace] = []
    for number, (first, last, feet, patch) in enumerate(stages):
        if number == 1:
            traces.append(_flight(leap, way))
        length = float(np.linalg.norm(last[0] - first[0]))
        speed = float(np.linalg.norm(leap.speed if number == 0 else arriving))
        whole = max(2.5 * length / max(speed, 0.1), 0.3)
        # Time runs differently far from the leap and next to it
        shares = (0.0, 0.6, 1.0) if number == 0 else (0.0, 0.4, 1.0)
        for name, a, b in zip(("stance", "stance"), shares[:-1], shares[1:], strict=True):
            t = np.linspace(a, b, KNOTS + 1)
            path = _hermite(first, last, whole, t)
            low, high = _block_for(way, path.position[0], path.position[-1])
            force = np.zeros((KNOTS + 1, 4, 3))
            force[:, :, 2] = scene.weight / 4
            patches = dict.fromkeys(range(4), patch)
            phase = LegPhase(name, low, high, KNOTS, 0.05, 8.0, patches=patches)
            controls = np.zeros((4, CONTROLS, 6))
            traces.append(LegTrace(phase, whole * (b - a), *path, feet, feet, controls, force))
    return traces


def _flight(leap: Leap, way: Corridor) -> LegTrace:
    everything = (0, 1, 2, 3)
    # Over an edge no block holds all of it: what it touches is cut off
    low, high = way.blocks[:, 0].min(axis=0), way.blocks[:, 1].max(axis=0)
    patches = dict.fromkeys(everything, leap.patches[1])
    phase = LegPhase("flight", low, high, 1, 0.08, 1.2, swing=everything, patches=patches)
    share = np.linspace(0, 1, CONTROLS)[None, :, None]
    first, last = leap.angles[:, :1], leap.angles[:, 1:]
    down = np.array([0, 0, -GRAVITY])
    return LegTrace(
        phase,
        leap.duration,
        np.stack([leap.takeoff, leap.landing]),
        np.stack([leap.speed, leap.speed + down * leap.duration]),
        np.tile(down, (2, 1)),
        leap.before,
        leap.after,
        first + share * (last - first),
        np.zeros((2, 4, 3)),
    )


def _hermite(
    first: tuple[Array, Array], last: tuple[Array, Array], whole: float, share: Array
) -> BoxPath:
    """A cubic between two positions with velocities, in `whole` seconds."""
    s = share[:, None]
    (p, v), (q, w) = first, last
    bend = 6 * (q - p) / whole**2 - (4 * v + 2 * w) / whole  # acceleration at the start
    slope = (w - v) / whole - bend  # its change over the half of the time
    return BoxPath(
        p + whole * s * v + whole**2 * s**2 * (bend / 2 + slope * s / 3),
        v + whole * s * (bend + slope * s),
        bend + 2 * slope * s,
    )


def _block_for(way: Corridor, first: Array, last: Array) -> Array:
    """The block that holds both ends of a phase best."""

    def outside(block: Array) -> float:
        return float(
            sum(np.maximum(np.maximum(block[0] - p, p - block[1]), 0).sum() for p in (first, last))
        )

    best: Array = min(way.blocks, key=outside)
    return best
