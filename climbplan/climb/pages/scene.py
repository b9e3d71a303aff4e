"""Climbs, transitions and missions as scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.pages.patches import (
    AxisAlignedBox,
    choose_oblique_camera,
    compute_climb_box,
    list_solid_faces,
    list_surface_patches,
    sort_shoulders,
)
from climbplan.climb.pages.replay import ReplayFrames, build_replay
from climbplan.climb.pages.series import list_instant_labels
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.plan.played import START
from climbplan.reports import palette
from climbplan.reports.viewer.scene import (
    Boxes,
    ForceArrows,
    Rods,
    Solids,
    StaticLines,
    StaticMesh,
    ViewerScene,
    build_polygons,
)
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.visual_geometry import BODY, compute_piece_poses, split_by_link


def read_scene(path: Path) -> ViewerScene:
    """Return the scene of a climb or transition plan file.

    Raises PlanFileError for a damaged file.
    """
    plan = read_climb(path)
    frames = build_replay(plan)
    rotation = rotation_world_body(frames.rpy)
    box = compute_climb_box(plan)
    camera = choose_oblique_camera(plan, -63.0, 18.0)
    return ViewerScene(
        title=plan.name,
        facts=_list_facts(plan),
        time=frames.time,
        caption=_write_captions(plan, frames),
        marks=np.flatnonzero(np.diff(frames.instant, prepend=START) != 0),
        shapes=_build_terrain(plan, box),
        paths=_build_paths(plan),
        rods=_build_rods(plan, frames, rotation) if plan.looks is None else None,
        boxes=_build_body(plan, frames, rotation) if plan.looks is None else None,
        solids=_build_solids(plan, frames, rotation),
        forces=_build_forces(plan, frames),
        lower=box.lower,
        upper=box.upper,
        azimuth_deg=camera.azimuth_deg,
        elevation_deg=camera.elevation_deg,
    )


def _list_facts(plan: ClimbPlan) -> tuple[str, ...]:
    forces = plan.forces
    torque, friction = forces.safety_torque.min(), forces.safety_friction.min()
    return (
        f"{plan.robot.name}, {plan.rounds.count} rounds, {plan.instants.count} instants",
        f"least S_tau {torque:.2f}, least S_mu {friction:.2f}",
        *_note_missing_visuals(plan),
    )


def _note_missing_visuals(plan: ClimbPlan) -> tuple[str, ...]:
    """Return a note where only the URDF has the robot's own shape."""
    if plan.looks is not None or "<visual" not in plan.robot_texts.urdf:
        return ()
    return (f"drawn as capsules: the plan carries no visual geometry of {plan.robot.name}",)


def _write_captions(plan: ClimbPlan, frames: ReplayFrames) -> tuple[str, ...]:
    labels, forces = list_instant_labels(plan), plan.forces
    texts = [
        f"{label}: S_tau {torque:.2f}, S_mu {friction:.2f}"
        for label, torque, friction in zip(
            labels, forces.safety_torque, forces.safety_friction, strict=True
        )
    ]
    return tuple("before the first lift" if k == START else texts[k] for k in frames.instant)


def _build_terrain(plan: ClimbPlan, box: AxisAlignedBox) -> tuple[StaticMesh, ...]:
    shapes = []
    for surface in plan.terrain.surfaces:
        corners = [patch.vertices for patch in list_surface_patches(surface, box)]
        if corners:
            note = f"{surface.name}  mu {surface.friction:g}"
            shapes.append(build_polygons(surface.name, corners, palette.SURFACE, 0.45, note))
    for solid in plan.terrain.obstacles:
        corners = [face.vertices for face in list_solid_faces(solid, box)]
        if corners:
            shapes.append(build_polygons(solid.name, corners, palette.OBSTACLE, 0.9))
    return tuple(shapes)


def _build_paths(plan: ClimbPlan) -> tuple[StaticLines, ...]:
    com, toes = plan.rounds.com, plan.rounds.toes
    body = StaticLines("body", np.stack([com[:-1], com[1:]], axis=1), palette.TRACE)
    limbs = [
        StaticLines(
            name,
            np.stack([toes[:-1, limb], toes[1:, limb]], axis=1),
            palette.choose_limb_color(limb),
        )
        for limb, name in enumerate(plan.robot.limb_names)
    ]
    return (body, *limbs)


def _build_rods(plan: ClimbPlan, frames: ReplayFrames, rotation: Array) -> Rods:
    robot, count = plan.robot, len(frames.time)
    root = joint_points_body(robot, np.zeros(plan.robot.joint_lower.shape))[:, 0]  # (N, 3)
    shoulder = frames.com[:, None] + np.einsum("fij,nj->fni", rotation, root)
    chain = np.concatenate([shoulder[:, :, None], frames.joints], axis=2)  # (F, N, J + 1, 3)
    links = np.stack([chain[:, :, :-1], chain[:, :, 1:]], axis=3)  # (F, N, J, 2, 3)
    joints = links.shape[2]
    ring = sort_shoulders(plan)
    frame = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)  # (N, 2, 3)
    frame_ends = frames.com[:, None, None] + np.einsum("fij,nkj->fnki", rotation, frame)
    torque_ratio = np.abs(plan.forces.motor_torques) / robot.max_torque  # (K, N, J)
    load = np.zeros((count, robot.limb_count, joints))
    acting = frames.instant != START
    load[acting] = torque_ratio[frames.instant[acting]]
    limbs = robot.limb_count * joints
    radius = robot.limb_radius
    ends = np.concatenate([links.reshape(count, limbs, 2, 3), frame_ends], axis=1)
    frame_radius = np.full(len(ring), 0.6 * radius)
    if robot.gripper is not None:
        normal = plan.instants.normal[np.maximum(frames.instant, 0)]
        wrist = chain[:, :, -1]
        grips = np.stack([wrist, wrist - robot.gripper.length * normal], axis=2)
        ends = np.concatenate([ends, grips], axis=1)
        frame_radius = np.append(frame_radius, np.full(robot.limb_count, 0.5 * radius))
    num_others = len(frame_radius)
    return Rods(
        ends=ends,
        radius=np.concatenate([np.full(limbs, radius), frame_radius]),
        color=(
            *(palette.choose_limb_color(n) for n in range(robot.limb_count) for _ in range(joints)),
            *(palette.BODY for _ in range(num_others)),
        ),
        load=np.concatenate([load.reshape(count, limbs), np.zeros((count, num_others))], axis=1),
    )


def _build_solids(plan: ClimbPlan, frames: ReplayFrames, rotation: Array) -> Solids | None:
    chain = plan.robot.mechanism
    if plan.looks is None or not isinstance(chain, SerialChain):
        return None
    pieces = split_by_link(plan.looks, chain)
    positions, rotations = compute_piece_poses(pieces, chain, frames.angles)
    torque_ratio = np.abs(plan.forces.motor_torques) / plan.robot.max_torque  # (K, N, J)
    load = np.zeros((len(frames.time), len(pieces)))
    acting = frames.instant != START
    for k, piece in enumerate(pieces):
        if piece.limb != BODY:
            load[acting, k] = torque_ratio[frames.instant[acting], piece.limb, piece.joint]
    return Solids(
        vertices=tuple(piece.vertices for piece in pieces),
        faces=tuple(piece.faces for piece in pieces),
        position=frames.com[:, None] + np.einsum("fij,fkj->fki", rotation, positions),
        rotation=np.einsum("fij,fkjl->fkil", rotation, rotations),
        color=tuple(
            palette.BODY if piece.limb == BODY else palette.choose_limb_color(piece.limb)
            for piece in pieces
        ),
        load=load,
    )


def _build_body(plan: ClimbPlan, frames: ReplayFrames, rotation: Array) -> Boxes:
    hull, count = plan.robot.body_hull, len(frames.time)
    lower, upper = hull.min(axis=0), hull.max(axis=0)
    center = frames.com + rotation @ ((lower + upper) / 2)
    size = np.broadcast_to(upper - lower, (count, 1, 3))
    return Boxes(center[:, None], rotation[:, None], size, (palette.BODY,), 0.8)


def _build_forces(plan: ClimbPlan, frames: ReplayFrames) -> ForceArrows:
    instants = plan.instants
    acting = frames.instant != START
    k: IntArray = np.where(acting, frames.instant, 0)
    pressing = acting[:, None] & instants.contact[k]  # (F, N)
    return ForceArrows(
        point=frames.joints[:, :, -1],
        force=plan.forces.force[k] * pressing[..., None],
        normal=instants.normal[k] * pressing[..., None],
        mu=np.where(pressing, instants.mu[k], 0.0),
    )
