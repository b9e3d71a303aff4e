"""A scene on a viser server: what is drawn at a time, and what can be switched off."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
import viser
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.reports import palette
from climbplan.reports.viewer.scene import (
    Boxes,
    ForceArrows,
    Rods,
    Solids,
    ViewerScene,
    interpolate,
)

_LONGEST_FORCE = 0.2  # share of the scene's size
_LOAD_COLORS = np.array([[77, 163, 127], [230, 200, 60], [192, 57, 43]], float)  # 0, half, limit
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def parse_rgb(color: str) -> tuple[int, int, int]:
    """Return red, green, blue of "#rrggbb"."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def map_load_to_color(load: Array) -> Array:
    """Return colours (..., 3) of shares of a limit: green, yellow at half of it, red from it on."""
    position = np.clip(load, 0.0, 1.0) * (len(_LOAD_COLORS) - 1)
    low = np.minimum(position.astype(int), len(_LOAD_COLORS) - 2)
    fraction = (position - low)[..., None]
    mixed: Array = np.rint((1 - fraction) * _LOAD_COLORS[low] + fraction * _LOAD_COLORS[low + 1])
    return mixed


def _convert_to_quaternions(rotation: Array) -> Array:
    """Return wxyz (..., 4) of rotations (..., 3, 3)."""
    flat = np.asarray(Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat())[:, [3, 0, 1, 2]]
    return flat.reshape(*rotation.shape[:-2], 4)


def _interpolate_quaternions(turns: Array, moment: tuple[int, int, float]) -> Array:
    """Return wxyz (K, 4) at a moment of samples (F, K, 4)."""
    before, after, fraction = moment
    first, second = turns[before], turns[after]
    second = np.where((first * second).sum(axis=1, keepdims=True) < 0, -second, second)
    blended = (1 - fraction) * first + fraction * second
    unit: Array = blended / np.linalg.norm(blended, axis=1, keepdims=True)
    return unit


def _open_cone() -> trimesh.Trimesh:
    """Return a cone with its apex at the origin that opens along z: height 1, radius 1."""
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(angle)])
    around = np.arange(len(rim))
    faces = np.column_stack([np.zeros_like(around), 1 + around, 1 + np.roll(around, -1)])
    return trimesh.Trimesh(np.vstack([np.zeros(3), rim]), faces, process=False)


def _align_z_to(direction: Array) -> Array:
    """Return wxyz (K, 4) that rotate z to directions (K, 3) of any length; zero: no rotation."""
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    unit = np.where(length > 0, direction / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    # Half way between z and the direction; turned about x where they are opposite.
    w = 1.0 + unit[:, 2]
    quaternion = np.column_stack([w, -unit[:, 1], unit[:, 0], np.zeros(len(unit))])
    quaternion[w < 1e-9] = [0.0, 1.0, 0.0, 0.0]
    unit_quaternion: Array = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return unit_quaternion


class SceneHandles:
    """The handles of everything drawn of one scene."""

    def __init__(self, server: viser.ViserServer, scene: ViewerScene) -> None:
        self._scene, self._server = scene, server
        self._size = float(np.linalg.norm(scene.upper - scene.lower))
        self.show_loads = False
        self._terrain: list[Any] = []
        self._labels: list[Any] = []
        self._paths: list[Any] = []
        self._moving: dict[str, Any] = {}
        server.scene.set_up_direction("+z")
        self._add_terrain()
        if scene.boxes is not None:
            self._quaternion = _convert_to_quaternions(scene.boxes.rotation)
            self._add_boxes(scene.boxes)
        if scene.rods is not None:
            self._add_rods(scene.rods)
        self._solids: list[Any] = []
        if scene.solids is not None:
            self._turns = _convert_to_quaternions(scene.solids.rotation)
            self._add_solids(scene.solids)
        if scene.forces is not None:
            self._add_forces(scene.forces)
        self._aim()

    def _aim(self) -> None:
        """Look at the middle of the scene from its first azimuth and elevation."""
        scene, camera = self._scene, self._server.initial_camera
        azimuth, elevation = np.deg2rad([scene.azimuth_deg, scene.elevation_deg])
        flat = np.array([np.cos(azimuth), np.sin(azimuth)]) * np.cos(elevation)
        middle = (scene.lower + scene.upper) / 2
        camera.look_at = tuple(middle)
        camera.position = tuple(middle + 1.05 * self._size * np.append(flat, np.sin(elevation)))
        camera.up = (0.0, 0.0, 1.0)
        camera.fov = float(np.deg2rad(50.0))

    def draw(self, time: float) -> str:
        """Show a time [s]; returns the caption of that moment."""
        scene, moment = self._scene, self._scene.moment(time)
        with self._server.atomic():
            if scene.rods is not None:
                self._draw_rods(scene.rods, moment)
            if scene.boxes is not None:
                self._draw_boxes(scene.boxes, moment)
            if scene.solids is not None:
                self._draw_solids(scene.solids, moment)
            if scene.forces is not None:
                self._draw_forces(scene.forces, moment)
        return scene.caption[moment[0]]

    def switch(self, what: str, visible: bool) -> None:
        """Show or hide "terrain", "labels", "paths", "forces" or "cones"."""
        for handle in self._group(what):
            handle.visible = visible

    def has(self, what: str) -> bool:
        """Return whether there is any of it to show or hide."""
        return bool(self._group(what))

    def _group(self, what: str) -> list[Any]:
        groups = {"terrain": self._terrain, "labels": self._labels, "paths": self._paths}
        return groups.get(what, [self._moving[what]] if what in self._moving else [])

    def _add_terrain(self) -> None:
        for number, shape in enumerate(self._scene.shapes):
            mesh = self._server.scene.add_mesh_simple(
                f"/terrain/{number}",
                shape.vertices,
                shape.faces,
                color=parse_rgb(shape.color),
                opacity=shape.opacity if shape.opacity < 1 else None,
                flat_shading=True,
                side="double",
                cast_shadow=False,
            )
            self._terrain.append(mesh)
            if shape.note:
                label_position = shape.vertices.mean(axis=0)
                self._labels.append(
                    self._server.scene.add_label(
                        f"/label/{number}", shape.note, position=tuple(label_position)
                    )
                )
        for path in self._scene.paths:
            if len(path.ends):
                self._paths.append(
                    self._server.scene.add_line_segments(
                        f"/path/{path.name}",
                        path.ends.astype(np.float32),
                        parse_rgb(path.color),
                        thickness=0.002 * self._size,
                    )
                )

    def _batch(self, name: str, mesh: Any, count: int, color: Array, **more: Any) -> None:
        self._moving[name] = self._server.scene.add_batched_meshes_simple(
            f"/{name}",
            np.asarray(mesh.vertices, np.float32),
            np.asarray(mesh.faces, np.uint32),
            batched_wxyzs=np.tile(_UPRIGHT, (count, 1)),
            batched_positions=np.zeros((count, 3)),
            batched_scales=np.ones((count, 3)),
            batched_colors=color.astype(np.uint8),
            lod="off",
            **more,
        )

    def _add_rods(self, rods: Rods) -> None:
        count = len(rods.radius)
        self._rod_colors = np.array([parse_rgb(color) for color in rods.color])
        self._batch("rods", trimesh.creation.cylinder(1.0, 1.0, 16), count, self._rod_colors)
        ball = trimesh.creation.icosphere(2, 1.0)
        self._batch("joints", ball, 2 * count, np.repeat(self._rod_colors, 2, axis=0))

    def _add_boxes(self, boxes: Boxes) -> None:
        colors = np.array([parse_rgb(color) for color in boxes.color])
        opacity = boxes.opacity if boxes.opacity < 1 else None
        cube = trimesh.creation.box((1.0, 1.0, 1.0))
        self._batch("boxes", cube, len(boxes.color), colors, opacity=opacity, flat_shading=True)

    def _add_solids(self, solids: Solids) -> None:
        for number, (vertices, faces) in enumerate(zip(solids.vertices, solids.faces, strict=True)):
            mesh = self._server.scene.add_mesh_simple(
                f"/solid/{number}",
                vertices.astype(np.float32),
                faces.astype(np.uint32),
                color=parse_rgb(solids.color[number]),
                flat_shading=True,
                side="double",
            )
            self._solids.append(mesh)

    def _add_forces(self, forces: ForceArrows) -> None:
        largest = float(np.linalg.norm(forces.force, axis=-1).max(initial=0.0))
        self._metres_per_newton = _LONGEST_FORCE * self._size / largest if largest > 0 else 0.0
        count = forces.point.shape[1]
        self._moving["forces"] = self._server.scene.add_arrows(
            "/forces",
            np.zeros((count, 2, 3), np.float32),
            parse_rgb(palette.FORCE),
            shaft_radius=0.005 * self._size,
            head_radius=0.011 * self._size,
            head_length=0.03 * self._size,
        )
        if (forces.mu > 0).any():
            cone = _open_cone()
            color = np.tile(parse_rgb(palette.CONE_SHRUNK), (count, 1))
            self._batch("cones", cone, count, color, opacity=0.45, side="double", cast_shadow=False)

    def _draw_rods(self, rods: Rods, moment: tuple[int, int, float]) -> None:
        ends = interpolate(rods.ends, moment)
        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=1)
        handle, balls = self._moving["rods"], self._moving["joints"]
        handle.batched_positions = ends.mean(axis=1)
        handle.batched_wxyzs = _align_z_to(along)
        handle.batched_scales = np.column_stack([rods.radius, rods.radius, length])
        balls.batched_positions = ends.reshape(-1, 3)
        balls.batched_scales = np.repeat(rods.radius, 2)[:, None] * np.ones(3)
        colors = self._rod_colors.astype(float)
        if self.show_loads and rods.load is not None:
            colors = map_load_to_color(rods.load[moment[0]])
        handle.batched_colors = colors.astype(np.uint8)
        balls.batched_colors = np.repeat(colors, 2, axis=0).astype(np.uint8)

    def _draw_boxes(self, boxes: Boxes, moment: tuple[int, int, float]) -> None:
        handle = self._moving["boxes"]
        handle.batched_positions = interpolate(boxes.center, moment)
        handle.batched_wxyzs = _interpolate_quaternions(self._quaternion, moment)
        handle.batched_scales = np.maximum(boxes.size[moment[0]], 1e-6)

    def _draw_solids(self, solids: Solids, moment: tuple[int, int, float]) -> None:
        position, turns = (
            interpolate(solids.position, moment),
            _interpolate_quaternions(self._turns, moment),
        )
        colors = np.array([parse_rgb(color) for color in solids.color], float)
        if self.show_loads and solids.load is not None:
            colors = map_load_to_color(solids.load[moment[0]])
        for handle, solid_position, turn, color in zip(
            self._solids, position, turns, colors, strict=True
        ):
            handle.position, handle.wxyz = solid_position, turn
            handle.color = tuple(int(channel) for channel in color)

    def _draw_forces(self, forces: ForceArrows, moment: tuple[int, int, float]) -> None:
        k, scale = moment[0], self._metres_per_newton
        point = interpolate(forces.point, moment)
        acting = np.linalg.norm(forces.force[k], axis=1) > 0
        ends = np.stack([point, point + scale * forces.force[k]], axis=1)[acting]
        self._moving["forces"].points = ends.astype(np.float32)
        if "cones" in self._moving:
            pressing = (forces.normal[k] * forces.force[k]).sum(axis=1)
            height = np.maximum(scale * pressing, 1e-6)
            cones = self._moving["cones"]
            cones.batched_positions = point
            cones.batched_wxyzs = _align_z_to(forces.normal[k])
            width = np.maximum(height * forces.mu[k], 1e-6)
            cones.batched_scales = np.column_stack([width, width, height])
