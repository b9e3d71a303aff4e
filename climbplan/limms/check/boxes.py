"""Checks of the box: dynamics, forces, support, goal (eqs. (6.5) to (6.8))."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.check.dense import anchor_pose, events, fine_times, hermite
from climbplan.limms.check.kinematics import turned
from climbplan.limms.check.limits import judge
from climbplan.limms.check.loads import inertia_about_vertical
from climbplan.limms.check.worst import Worst
from climbplan.limms.modules.distances import upright_gap
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS
from climbplan.limms.schema.module import ModuleSpec
from climbplan.verification.check import Check

_STABLE, _FREE, _HELD, _QUADRUPED = 1, 2, 3, 4
_AT_GOAL = 1e-4  # [m, rad]
_KEEPS = 1e-9  # [rad] between start and goal of a box that does not turn


def box_checks(plan: LimmsPlan, module: ModuleSpec) -> Iterator[Check]:
    """Everything about the boxes."""
    worst = Worst()
    for first, last in events(plan.motion.time):
        _motion(plan, first, last, worst)
        for b in range(len(plan.box_size)):
            _forces(plan, module, b, first, last, worst)
    for name in ("box.motion", "box.dynamics", "box.stable", "box.moment"):
        yield worst.check(name)
    yield worst.check("clear.box", gap=True)
    for name in ("latch.moment", "force.limit", "force.friction", "force.unattached"):
        yield worst.check(name)
    yield worst.check("support.sides", gap=True)
    yield from _goal_checks(plan)


def _goal_checks(plan: LimmsPlan) -> Iterator[Check]:
    """All boxes are at their goals in the end, and came there one after the other."""
    count = plan.deliveries
    which = [f"box {b}" if count > 1 else "" for b in range(count)]
    off = np.linalg.norm(plan.motion.box_position[-1] - plan.goal, axis=-1)[:count]
    worst = int(np.argmax(off))
    yield judge("goal.reached", off[worst], which[worst], f"{1e3 * off[worst]:.3f} mm off")
    turn = _turned_wrongly(plan)
    worst = int(np.argmax(turn))
    place = (which[worst] if worst < count else f"parked box {worst - count}") if turn.any() else ""
    yield judge("goal.turned", turn[worst], place, f"{np.degrees(turn[worst]):.4f} degrees off")
    # Only the last box may still move
    speed = np.linalg.norm(plan.motion.box_velocity[-1, :count], axis=-1)
    allowed = np.array([*np.zeros(count - 1), plan.arrival_speed])
    over = speed - allowed
    # One that arrives at rest does not turn either
    over = np.maximum(over, np.where(allowed > 0, 0, np.abs(plan.motion.box_yaw_rate[-1, :count])))
    worst = int(np.argmax(over))
    yield judge("goal.speed", over[worst], which[worst], f"{speed[worst]:.3f} m/s at the end")
    came = np.array([_arrival(plan, b) for b in range(count)])
    early = came[:-1] - came[1:]
    late = max(float(early.max(initial=0.0)), 0.0)
    place = f"box {int(np.argmax(early)) + 1} before the one it comes after" if late else ""
    yield judge("goal.order", late, place)


def _turned_wrongly(plan: LimmsPlan) -> Array:
    """By how much each box (B,) misses its yaw in the end; of one that keeps it, ever [rad]."""
    yaw = plan.motion.box_yaw
    ends = np.abs((yaw[-1] - plan.goal_yaw + np.pi) % (2 * np.pi) - np.pi)
    asked = np.abs((plan.goal_yaw - yaw[0] + np.pi) % (2 * np.pi) - np.pi)
    return np.where(asked > _KEEPS, ends, np.maximum(ends, np.abs(yaw - yaw[0]).max(axis=0)))


def _arrival(plan: LimmsPlan, b: int) -> float:
    """Since when a box is where it ends [s]."""
    off = np.abs(plan.motion.box_position[:, b] - plan.motion.box_position[-1, b]).max(axis=1)
    off = np.maximum(off, np.abs(plan.motion.box_yaw[:, b] - plan.motion.box_yaw[-1, b]))
    away = np.flatnonzero(off > _AT_GOAL)
    return float(plan.motion.time[away[-1]]) if len(away) else 0.0


def _motion(plan: LimmsPlan, first: int, last: int, worst: Worst) -> None:
    """Position, velocity and acceleration belong together; nothing in the box's way."""
    motion = plan.motion
    span = slice(first, last + 1)
    time = motion.time[span]
    h = np.diff(time)[:, None, None]
    p, v, a = (
        np.concatenate([moved[span], turning[span, :, None]], axis=2)
        for moved, turning in (
            (motion.box_position, motion.box_yaw),
            (motion.box_velocity, motion.box_yaw_rate),
            (motion.box_acceleration, motion.box_yaw_acceleration),
        )
    )
    off_v = v[1:] - v[:-1] - h * (a[:-1] + a[1:]) / 2
    off_p = p[1:] - p[:-1] - h * v[:-1] - h**2 * (2 * a[:-1] + a[1:]) / 6
    worst.look("box.motion", time[1:], np.abs(off_v / h).max(axis=(1, 2)))
    worst.look("box.motion", time[1:], np.abs(off_p / h).max(axis=(1, 2)))
    at = fine_times(time)
    place, _ = hermite(time, p, v, at)
    box, yaw = place[..., :3], place[..., 3]
    for anchor in range(4 * len(plan.box_size)):
        there = anchor_pose(plan, anchor, 0, p[..., :3], p[..., 3]).position
        off = np.abs(motion.anchor_position[span, anchor] - there)
        worst.look("box.motion", time, off, plan.anchor_names[anchor])
    half = plan.box_size / 2
    for b in range(len(half)):
        for low, high in plan.solids:
            block = (high + low) / 2, np.zeros(1), (high - low) / 2
            gap = upright_gap(box[:, b], yaw[:, b], half[b], *block)
            worst.look("clear.box", at, -gap, f"box {b}")
        for other in range(b):
            block = box[:, other], yaw[:, other], half[other]
            gap = upright_gap(box[:, b], yaw[:, b], half[b], *block)
            worst.look("clear.box", at, -gap, f"box {b}")
        if motion.box_mode[first, b] == _STABLE:
            moved = np.abs(place[:, b] - place[0, b]).max(axis=1)
            bottom = box[:, b].copy()
            bottom[:, 2] -= half[b, 2]
            worst.look("box.stable", at, np.maximum(moved, _above_ground(plan, bottom)))


def _above_ground(plan: LimmsPlan, points: Array) -> Array:
    best = np.full(len(points), np.inf)
    for low, high in plan.solids:
        over = ((points[:, :2] >= low[:2]) & (points[:, :2] <= high[:2])).all(axis=1)
        best = np.minimum(best, np.where(over, np.abs(points[:, 2] - high[2]), np.inf))
    return best


def _forces(
    plan: LimmsPlan, module: ModuleSpec, b: int, first: int, last: int, worst: Worst
) -> None:
    motion = plan.motion
    span = slice(first, last + 1)
    time, force = motion.time[span], motion.force[span, b]  # (n, 4, 3)
    mode = int(motion.box_mode[first, b])
    if mode != _STABLE:
        mass = plan.box_mass[b]
        needed = mass * (motion.box_acceleration[span, b] + np.array([0, 0, GRAVITY]))
        worst.look("box.dynamics", time, np.abs(force.sum(axis=1) - needed))
    frame = turned(motion.box_yaw[span, b])  # (n, 3, 3) to the world
    wanted = np.zeros((len(time), 3))  # moment that turns it as planned
    wanted[:, 2] = inertia_about_vertical(plan, b) * motion.box_yaw_acceleration[span, b]
    if mode == _FREE:
        worst.look("box.moment", time, np.abs(wanted))
    size = np.linalg.norm(force, axis=-1)
    worst.look("force.limit", time, size - module.max_force)
    holders = _holders(plan, b, first)
    for side in range(4):
        m, end = holders[side]
        what = plan.anchor_names[4 * b + side]
        foot_down = m >= 0 and motion.ground_end[first, m] == 1 - end
        loose = m < 0 or (mode == _QUADRUPED and not foot_down)
        if loose:
            worst.look("force.unattached", time, size[:, side], what)
        if mode == _QUADRUPED and m >= 0:
            foot = motion.joint_position[span, m, 7 * (1 - end)]
            normal = SIDE_NORMALS[side]
            half = float(np.abs(normal) @ plan.box_size[b] / 2)
            ahead = ((foot - motion.box_position[span, b]) * (frame @ normal)).sum(axis=1)
            if foot_down:
                worst.look("support.sides", time, half - ahead, what)
                f = force[:, side]
                sliding = np.hypot(f[:, 0], f[:, 1]) - plan.friction * f[:, 2]
                worst.look("force.friction", time, sliding, what)
    if mode == _QUADRUPED:
        moment = np.zeros((len(time), 3))
        for side, (m, end) in enumerate(holders):
            if m >= 0:
                foot = motion.joint_position[span, m, 7 * (1 - end)]
                moment += np.cross(foot - motion.box_position[span, b], force[:, side])
        worst.look("box.moment", time, np.abs(moment - wanted))
    if mode == _HELD:
        held = [side for side in range(4) if holders[side][0] >= 0]
        if not held:
            return
        offsets = (SIDE_NORMALS[held] * plan.box_size[b] / 2) @ np.swapaxes(frame, 1, 2)
        # Moments that the latches have to hold, shared as little as can be
        left = wanted - np.cross(offsets, force[:, held]).sum(axis=1)
        each = np.linalg.norm(left, axis=1) / len(held)
        worst.look("latch.moment", time, each - module.latch_moment)


def _holders(plan: LimmsPlan, b: int, sample: int) -> list[tuple[int, int]]:
    """Module and end on each side of a box, (-1, 0) if none."""
    motion = plan.motion
    found = [(-1, 0)] * 4
    for m in range(len(plan.module_names)):
        for end, anchors in enumerate((motion.base_anchor, motion.tip_anchor)):
            side = int(anchors[sample, m]) - 4 * b
            if 0 <= side < 4:
                found[side] = (m, end)
    return found
