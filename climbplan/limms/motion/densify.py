"""From knots to dense samples: exact cubics, closed chains solved anew, forces made exact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import inverse
from climbplan.limms.modules.limbs import limb_frames, side_pose
from climbplan.limms.motion.cubics import box_path, knot_samples
from climbplan.limms.motion.straight_ways import closest_branch, rates_of
from climbplan.limms.motion.timeline import (
    FREE,
    MANIPULATED,
    NOWHERE,
    PartialPlan,
    Stretch,
    samples,
)
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS, Pose, Scene
from climbplan.limms.scene.phases import Limb, PhaseTrajectory, compute_load_sharing
from climbplan.limms.scene.placement import (
    centre_of,
    inertia_about_vertical,
    rotate_to_world,
    yaw_of,
)

_RETREATS = ((12.0, 0.05), (25.0, 0.03), (50.0, 0.02), (100.0, 0.01))  # [m/s^2], [s]


class Follow(Exception):
    """A module cannot follow what the box does after it let go."""


def add_traces(
    world: PartialPlan, limbs: Sequence[Limb], traces: Sequence[PhaseTrajectory]
) -> None:
    """Add the stretches of solved phases to a plan.

    Raises:
        Follow: a module that threw cannot get out of the box's way.
    """
    for trace in traces:
        if trace.phase.kind == "flight":
            _add_flight(world, limbs, trace)
        else:
            _add_held(world, limbs, trace)


def _add_held(world: PartialPlan, limbs: Sequence[Limb], trace: PhaseTrajectory) -> None:
    scene, phase = world.scene, trace.phase
    time = knot_samples(trace.duration, phase.intervals)
    position, velocity, acceleration = box_path(
        trace.duration, trace.position, trace.velocity, trace.acceleration, time
    )
    world.box_mode = MANIPULATED
    stretch = world.rest(phase.kind, time)
    _move_box(stretch, position, velocity, acceleration)
    roots = np.tile(trace.feet[0], (len(time), 1, 1))
    for i, limb in enumerate(limbs):
        first, last = limb_frames(scene, limb, position, roots[:, i])
        shape = (len(time), 3, 3)
        first = Pose(first.position, np.broadcast_to(first.rotation, shape))
        last = Pose(last.position, np.broadcast_to(last.rotation, shape))
        angles = closest_branch(scene.module, first, last, trace.angles[0, i], trace.angles[-1, i])
        # Whole turns of rolls count on from where they are
        turn = np.round((world.angles[limb.module] - angles[0]) / (2 * np.pi)) * 2 * np.pi
        stretch.place(limb.module, first, angles + turn, rates_of(time, angles))
    force = _held_forces(scene, limbs, position, acceleration)
    for i, limb in enumerate(limbs):
        stretch.force[:, limb.side] = force[:, i]
    world.add(stretch)


def _move_box(stretch: Stretch, position: Array, velocity: Array, acceleration: Array) -> None:
    """Placements (n, D) and their rates."""
    for k, (values, moved) in enumerate(
        (
            (position, stretch.box),
            (velocity, stretch.velocity),
            (acceleration, stretch.acceleration),
        )
    ):
        moved[:] = centre_of(values)
        stretch.turning[:, k] = yaw_of(values)


def _held_forces(
    scene: Scene, limbs: Sequence[Limb], position: Array, acceleration: Array
) -> Array:
    """Of the latches on the box (n, limbs, 3), world frame [N]."""
    offsets = np.array([scene.side_offset(0, limb.side) for limb in limbs])
    share = compute_load_sharing(offsets, scene.module.max_force, scene.module.latch_moment)
    mass, yaw = float(scene.box_mass[0]), yaw_of(position)
    wrench = np.empty((len(position), 4))
    wrench[:, :3] = rotate_to_world(
        -yaw, mass * (centre_of(acceleration) + np.array([0, 0, GRAVITY]))
    )
    wrench[:, 3] = inertia_about_vertical(mass, scene.box_size[0]) * yaw_of(acceleration)
    both = wrench @ share[: 3 * len(limbs)].T
    return rotate_to_world(yaw[:, None], both.reshape(len(wrench), len(limbs), 3))


def _add_flight(world: PartialPlan, limbs: Sequence[Limb], trace: PhaseTrajectory) -> None:
    """The box flies; modules that threw it stop beside its way."""
    scene = world.scene
    time = samples(trace.duration)
    position, velocity, acceleration = box_path(
        trace.duration, trace.position, trace.velocity, trace.acceleration, time
    )
    world.box_mode = FREE
    for limb in limbs:
        anchors = world.base_anchor if limb.box_end == 0 else world.tip_anchor
        anchors[limb.module] = NOWHERE
    stretch = world.rest("flight", time)
    _move_box(stretch, position, velocity, acceleration)
    for limb in limbs:
        start, held = side_pose(scene, position[0], limb.side, limb.box_end)
        normal = rotate_to_world(yaw_of(position[0]), SIDE_NORMALS[limb.side])
        # Of the latch's place as it lets go, on a box that turns too
        let_go = centre_of(velocity[0]) + np.cross(
            [0, 0, yaw_of(velocity[0])], start - position[0, :3]
        )
        for brake, hurry in _RETREATS:
            ends = _retreat(start, let_go, normal, time, brake, hurry)
            on_box = Pose(ends, np.broadcast_to(held, (len(time), 3, 3)))
            far = Pose(
                np.tile(limb.fixed_position, (len(time), 1)),
                np.broadcast_to(limb.other_rotation, (len(time), 3, 3)),
            )
            first, last = (on_box, far) if limb.box_end == 0 else (far, on_box)
            now = world.angles[limb.module]
            angles = _continued(scene, first, last, now)
            if angles is None:
                continue
            rates = rates_of(time, angles)
            if np.abs(rates).max() <= scene.module.max_joint_speed:
                break
        else:
            raise Follow(f"module {scene.module_names[limb.module]} cannot stop after the throw")
        stretch.place(limb.module, first, angles, rates)
    world.add(stretch)


def _retreat(
    start: Array, velocity: Array, normal: Array, time: Array, brake: float, hurry: float
) -> Array:
    """Way of a latch (n, 3) that lets go of a moving box and stops, ever further from its face."""
    away = float(velocity @ normal)
    aside = velocity - away * normal
    speed = float(np.linalg.norm(aside))
    stop = speed / brake
    t = np.minimum(time, stop)[:, None]
    direction = aside / speed if speed > 0 else np.zeros(3)
    ways = start + aside * t - brake * direction * t**2 / 2
    # Along the normal: speed up for a moment, then as fast as the box comes after, at least.
    gain = 0.15 / hurry
    u = np.minimum(time, hurry)
    path = away * time + gain * u**2 / 2 + gain * hurry * np.maximum(time - hurry, 0)
    if away < 0:  # the box leaves: stop
        slow = min(-away / brake, time[-1])
        v = np.minimum(time, slow)
        path = path - away * time + away * v + brake * v**2 / 2
    return np.asarray(ways + path[:, None] * normal)


def _continued(scene: Scene, first: Pose, last: Pose, now: Array) -> Array | None:
    """Angles (n, 6) that go on from `now`; None where the ends are out of reach."""
    from climbplan.limms.modules.chain import BRANCHES, in_range

    for branch in BRANCHES:
        solution = inverse(scene.module, first, last, branch)
        angles = np.unwrap(solution.angles, axis=0)
        angles = angles + np.round((now - angles[0]) / (2 * np.pi)) * 2 * np.pi
        if solution.missing.max() > 0 or in_range(scene.module, angles).max() > 0:
            continue
        if np.abs(angles[0] - now).max() < 1e-3:
            return angles
    return None
