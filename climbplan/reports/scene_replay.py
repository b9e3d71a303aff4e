"""A scene as its page plays it: values for JSON, and the moment at which it begins."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.reports import palette
from climbplan.reports.viewer.camera import compute_camera_path, measure_moving_parts
from climbplan.reports.viewer.scene import ViewerScene, compute_outline

_LONGEST_FORCE = 0.5  # share of what moves
_BEFORE = 1.0  # [s] before a box first moves
_MOVED = 1e-3  # [m]


def build_scene_replay(scene: ViewerScene) -> dict[str, Any]:
    """Return plain values, rounded to 0.1 mm; forces as arrows [m] that end at their points."""
    middle, extent = measure_moving_parts(scene)
    data: dict[str, Any] = {
        "time": scene.time.round(4).tolist(),
        "start": round(find_start_time(scene), 3),
        "caption": list(scene.caption),
        "middle": _round_values(
            compute_camera_path(scene, middle, scene.time)
        ),  # (F, 3) what the camera follows
        "extent": extent,  # [m] of what moves
        "azimuth": scene.azimuth_deg,
        "elevation": scene.elevation_deg,
        "shapes": [
            {
                "vertices": _round_values(shape.vertices),
                "faces": shape.faces.tolist(),
                "outline": compute_outline(shape).tolist(),
                "color": shape.color,
                "opacity": shape.opacity,
            }
            for shape in scene.shapes
        ],
    }
    if scene.boxes is not None:
        boxes = scene.boxes
        data["boxes"] = {
            "center": _round_values(boxes.center),
            "rotation": _round_values(boxes.rotation),
            "size": _round_values(boxes.size),
            "color": list(boxes.color),
        }
    if scene.rods is not None:
        rods = scene.rods
        data["rods"] = {
            "ends": _round_values(rods.ends),
            "radius": rods.radius.tolist(),
            "color": list(rods.color),
        }
    if scene.forces is not None:
        forces = scene.forces
        largest = float(np.linalg.norm(forces.force, axis=-1).max(initial=0.0))
        scale = _LONGEST_FORCE * extent / largest if largest > 0 else 0.0
        data["forces"] = {
            "point": _round_values(forces.point),
            "arrow": _round_values(scale * forces.force),
            "color": palette.FORCE_ON_PAGES,
        }
    return data


def find_start_time(scene: ViewerScene) -> float:
    """Return the time [s] from which a scene is shown: shortly before the first box moves.

    What comes before can be looked at; a scene without boxes, or with one that moves at once, is
    shown from its first sample.
    """
    start = float(scene.time[0])
    if scene.boxes is None:
        return start
    displacement = np.linalg.norm(scene.boxes.center - scene.boxes.center[0], axis=-1).max(axis=1)
    moved_samples = np.flatnonzero(displacement > _MOVED)
    if not len(moved_samples):
        return start
    return max(start, float(scene.time[max(int(moved_samples[0]) - 1, 0)]) - _BEFORE)


def _round_values(values: Array) -> Any:
    return np.round(values, 4).tolist()
