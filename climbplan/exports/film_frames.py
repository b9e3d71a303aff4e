"""Single pictures of a scene at any time, drawn off screen by MuJoCo."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation, Slerp

from climbplan.arrays import Array
from climbplan.errors import MissingSolver, UsageError
from climbplan.reports import palette
from climbplan.reports.viewer.camera import compute_camera_path, measure_moving_parts
from climbplan.reports.viewer.scene import (
    Solids,
    StaticMesh,
    ViewerScene,
    compute_outline,
    interpolate,
)
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import Picture

WIDTH, HEIGHT = 1280, 720  # [pixels]
_SEEN_THROUGH = 0.25  # opacity of what stands still, at most
_FORCE = 0.22  # share of what moves: a largest force, half of the time
_LONGEST_FORCE = 0.4  # any
_MOST_TRIANGLES = 60_000
_MOST_OUTLINES = 600  # edges of shapes; scans have more, and are seen without
_WORLD = f"""<mujoco>
<visual><global offwidth="{WIDTH}" offheight="{HEIGHT}"/>
<quality shadowsize="0" offsamples="4"/><headlight ambient="0.45 0.45 0.45" diffuse="0.45 0.45 0.45"
 specular="0.1 0.1 0.1"/></visual>
<asset><texture type="skybox" builtin="gradient" rgb1="0.98 0.985 1" rgb2="0.84 0.88 0.93"
 width="64" height="64"/></asset><worldbody>
<light directional="true" dir="0.4 0.3 -1" diffuse="0.35 0.35 0.35" castshadow="false"/>
</worldbody></mujoco>"""


class Frames:
    """Draws a scene from a camera that follows what moves in it.

    A context: the graphics backend is held meanwhile. Raises MissingSolver where there is none, and
    UsageError for scenes too large to draw.
    """

    def __init__(self, scene: ViewerScene, headline: str = "") -> None:
        self._scene, self._headline = scene, headline
        mujoco = self._mujoco = load_mujoco("a film", "film")
        triangles = sum(len(shape.faces) for shape in scene.shapes)
        if triangles > _MOST_TRIANGLES:
            raise UsageError(
                f"{scene.title}: a terrain of {triangles} triangles, a film draws at most "
                f"{_MOST_TRIANGLES}; a smaller `crop` of the scan has fewer"
            )
        self._middle, self._extent = measure_moving_parts(scene)
        model = _build_model(mujoco, scene.solids)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        max_geoms = 200 + triangles + 4 * _MOST_OUTLINES + _count_geoms(scene)
        try:
            self._renderer = mujoco.Renderer(model, HEIGHT, WIDTH, max_geom=max_geoms)
        except Exception as error:  # graphics libraries raise errors of many kinds
            raise MissingSolver(
                f"no film: {type(error).__name__}: {error}; install EGL or OSMesa (libegl1, "
                "libosmesa6) for off-screen drawing"
            ) from error
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth = scene.azimuth_deg + 180.0  # it looks along this, not from there
        self._camera.elevation = -scene.elevation_deg
        self._camera.distance = 0.2 + 1.2 * self._extent
        self._renderer.update_scene(data, self._camera)
        self._model, self._data = model, data
        self._pen = _Pen(mujoco, self._renderer.scene)
        toward = _compute_view_direction(scene)
        foremost = float((self._middle @ toward).max())
        for shape in scene.shapes:
            # What stands wholly before all that moves, as the front wall of a room, would hide it
            if float((shape.vertices @ toward).min()) < foremost:
                self._shape(shape)
        self._force = _compute_typical_force(scene)
        self._still = self._renderer.scene.ngeom
        self._large, self._small = (ImageFont.load_default(size) for size in (26, 19))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._renderer.close()

    def render_at(self, time: float) -> Picture:
        """Return the picture (HEIGHT, WIDTH, 3) at a time of the plan [s]."""
        self._camera.lookat[:] = compute_camera_path(self._scene, self._middle, np.array([time]))[0]
        renderer = self._renderer
        self._mujoco.mjv_updateCamera(self._model, self._data, self._camera, renderer.scene)
        renderer.scene.ngeom = self._still
        moment = self._scene.moment(time)
        self._boxes(moment)
        self._rods(moment)
        self._solids(moment)
        self._forces(moment)
        return self._with_words(renderer.render(), time, moment[0])

    def _with_words(self, picture: Picture, time: float, sample: int) -> Picture:
        image = Image.fromarray(picture)
        pen = ImageDraw.Draw(image, "RGBA")
        for band in ((0, 0, WIDTH, 88 if self._headline else 58), (0, HEIGHT - 54, WIDTH, HEIGHT)):
            pen.rectangle(band, (255, 255, 255, 190))
        pen.text((28, 20), self._scene.title, palette.INK, self._large)
        if self._headline:
            pen.text((28, 54), self._headline, palette.MUTED, self._small)
        pen.text((28, HEIGHT - 42), self._scene.caption[sample], palette.INK, self._small)
        clock = f"{time - self._scene.time[0]:.1f} s of {np.ptp(self._scene.time):.1f} s"
        pen.text((WIDTH - 28, HEIGHT - 42), clock, palette.MUTED, self._small, anchor="ra")
        return np.asarray(image)

    def _shape(self, shape: StaticMesh) -> None:
        color = _parse_color(shape.color, min(shape.opacity, _SEEN_THROUGH))
        for corners in shape.vertices[shape.faces]:
            self._pen.triangle(corners, color)
        edges = compute_outline(shape)
        if len(edges) <= _MOST_OUTLINES:
            for start, end in shape.vertices[edges]:
                self._pen.rod(0.0015 * self._extent, start, end, _parse_color(palette.MUTED, 0.8))

    def _boxes(self, moment: tuple[int, int, float]) -> None:
        boxes = self._scene.boxes
        if boxes is None:
            return
        before, after, fraction = moment
        center = interpolate(boxes.center, moment)
        for k, color in enumerate(boxes.color):
            if not boxes.size[before, k].any():
                continue
            rotations = Rotation.from_matrix(boxes.rotation[[before, after], k])
            box_rotation = Slerp([0.0, 1.0], rotations)(fraction).as_matrix()
            self._pen.box(
                boxes.size[before, k] / 2,
                center[k],
                box_rotation,
                _parse_color(color, boxes.opacity),
            )

    def _rods(self, moment: tuple[int, int, float]) -> None:
        rods = self._scene.rods
        if rods is None:
            return
        for (start, end), radius, color in zip(
            interpolate(rods.ends, moment), rods.radius, rods.color, strict=True
        ):
            self._pen.rod(float(radius), start, end, _parse_color(color))

    def _solids(self, moment: tuple[int, int, float]) -> None:
        solids = self._scene.solids
        if solids is None:
            return
        before, after, fraction = moment
        position = interpolate(solids.position, moment)
        for k, color in enumerate(solids.color):
            rotations = Rotation.from_matrix(solids.rotation[[before, after], k])
            solid_rotation = Slerp([0.0, 1.0], rotations)(fraction).as_matrix()
            # MuJoCo keeps meshes about their centre of mass, along their axes of inertia
            mesh_position = position[k] + solid_rotation @ self._model.mesh_pos[k]
            mesh_rotation = Rotation.from_quat(self._model.mesh_quat[k][[1, 2, 3, 0]]).as_matrix()
            self._pen.mesh(k, mesh_position, solid_rotation @ mesh_rotation, _parse_color(color))

    def _forces(self, moment: tuple[int, int, float]) -> None:
        forces = self._scene.forces
        if forces is None:
            return
        point, force = interpolate(forces.point, moment), forces.force[moment[0]]
        for toe, newtons in zip(point, force, strict=True):
            size = float(np.linalg.norm(newtons))
            if size > 0:
                length = min(_FORCE * size / self._force, _LONGEST_FORCE) * self._extent
                # From behind the surface, which pushes: a leg that braces would hide it
                behind = toe - length / size * newtons
                self._pen.arrow(0.010 * self._extent, behind, toe, _parse_color(palette.FORCE))


class _Pen:
    """Adds geoms to a scene of MuJoCo."""

    def __init__(self, mujoco: Any, scene: Any) -> None:
        self._mujoco, self._scene = mujoco, scene
        self._kind = mujoco.mjtGeom

    def box(self, half: Array, position: Array, rotation: Array, color: Array) -> None:
        self._solid(self._kind.mjGEOM_BOX, half, position, rotation, color)

    def mesh(self, number: int, position: Array, rotation: Array, color: Array) -> None:
        self._solid(self._kind.mjGEOM_MESH, np.ones(3), position, rotation, color)
        # Every mesh is there twice, the second time as its hull
        self._scene.geoms[self._scene.ngeom - 1].dataid = 2 * number

    def triangle(self, corners: Array, color: Array) -> None:
        first_edge, second_edge = corners[1] - corners[0], corners[2] - corners[0]
        normal = np.cross(first_edge, second_edge)
        length = float(np.linalg.norm(normal))
        if length > 0:
            frame = np.stack([first_edge, second_edge, normal / length], axis=1)
            self._solid(self._kind.mjGEOM_TRIANGLE, np.ones(3), corners[0], frame, color)

    def rod(self, radius: float, start: Array, end: Array, color: Array) -> None:
        self._line(self._kind.mjGEOM_CAPSULE, radius, start, end, color)

    def arrow(self, radius: float, start: Array, end: Array, color: Array) -> None:
        # MuJoCo draws half of an arrow's length
        self._line(self._kind.mjGEOM_ARROW, radius, start, 2 * end - start, color)

    def _solid(self, kind: Any, size: Array, position: Array, frame: Array, color: Array) -> None:
        self._mujoco.mjv_initGeom(self._next(), kind, size, position, frame.ravel(), color)

    def _line(self, kind: Any, radius: float, start: Array, end: Array, color: Array) -> None:
        geom = self._next()
        nothing = np.zeros(3)
        self._mujoco.mjv_initGeom(geom, kind, nothing, nothing, np.eye(3).ravel(), color)
        self._mujoco.mjv_connector(geom, kind, radius, start, end)

    def _next(self) -> Any:
        self._scene.ngeom += 1
        return self._scene.geoms[self._scene.ngeom - 1]


def _build_model(mujoco: Any, solids: Solids | None) -> Any:
    """Return an empty world that holds the meshes of what moves, in their order."""
    world = mujoco.MjSpec.from_string(_WORLD)
    pairs = () if solids is None else tuple(zip(solids.vertices, solids.faces, strict=True))
    for number, (vertices, faces) in enumerate(pairs):
        world.add_mesh(
            name=f"solid {number}",
            uservert=vertices.ravel(),
            userface=faces.ravel(),
            smoothnormal=False,
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
    return world.compile()


def _parse_color(color: str, opacity: float = 1.0) -> Array:
    """Return the channels (4,) of "#rrggbb" with an opacity."""
    channels = [int(color[offset : offset + 2], 16) / 255 for offset in (1, 3, 5)]
    return np.array([*channels, opacity], np.float32)


def _count_geoms(scene: ViewerScene) -> int:
    """Return geoms of what moves, at most."""
    rods = 0 if scene.rods is None else len(scene.rods.radius)
    boxes = 0 if scene.boxes is None else len(scene.boxes.color)
    solids = 0 if scene.solids is None else len(scene.solids.faces)
    return rods + boxes + solids + (0 if scene.forces is None else scene.forces.point.shape[1])


def _compute_view_direction(scene: ViewerScene) -> Array:
    """Return unit vector (3,) to where the scene is seen from."""
    azimuth, elevation = np.deg2rad([scene.azimuth_deg, scene.elevation_deg])
    flat = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    return np.append(flat, np.sin(elevation))


def _compute_typical_force(scene: ViewerScene) -> float:
    """Return the largest force of a sample, in the middle of all samples that have one [N]."""
    if scene.forces is None:
        return 1.0
    largest = np.linalg.norm(scene.forces.force, axis=-1).max(axis=1, initial=0.0)
    return float(np.median(largest[largest > 0])) if largest.any() else 1.0
