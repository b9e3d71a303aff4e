"""A scene as its page plays it: values for JSON, and the moment at which it begins."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.reports import palette
from climbplan.reports.viewer.camera import followed, moving
from climbplan.reports.viewer.scene import Scene, outline

_LONGEST_FORCE = 0.5  # share of what moves
_BEFORE = 1.0  # [s] before a box first moves
_MOVED = 1e-3  # [m]


def scene_replay(scene: Scene) -> dict[str, Any]:
    """Plain values, rounded to 0.1 mm; forces as arrows [m] that end at their points."""
    middle, extent = moving(scene)
    data: dict[str, Any] = {
        "time": scene.time.round(4).tolist(),
        "start": round(beginning(scene), 3),
        "caption": list(scene.caption),
        "middle": _short(followed(scene, middle, scene.time)),  # (F, 3) what the camera follows
        "extent": extent,  # [m] of what moves
        "azimuth": scene.azimuth_deg,
        "elevation": scene.elevation_deg,
        "shapes": [
            {
                "vertices": _short(shape.vertices),
                "faces": shape.faces.tolist(),
                "outline": outline(shape).tolist(),
                "color": shape.color,
                "opacity": shape.opacity,
            }
            for shape in scene.shapes
        ],
    }
    if scene.boxes is not None:
        boxes = scene.boxes
        data["boxes"] = {
            "center": _short(boxes.center),
            "rotation": _short(boxes.rotation),
            "size": _short(boxes.size),
            "color": list(boxes.color),
        }
    if scene.rods is not None:
        rods = scene.rods
        data["rods"] = {
            "ends": _short(rods.ends),
            "radius": rods.radius.tolist(),
            "color": list(rods.color),
        }
    if scene.forces is not None:
        forces = scene.forces
        largest = float(np.linalg.norm(forces.force, axis=-1).max(initial=0.0))
        scale = _LONGEST_FORCE * extent / largest if largest > 0 else 0.0
        data["forces"] = {
            "point": _short(forces.point),
            "arrow": _short(scale * forces.force),
            "color": palette.FORCE_ON_PAGES,
        }
    return data


def beginning(scene: Scene) -> float:
    """The time [s] from which a scene is shown: shortly before the first box moves.

    What comes before can be looked at; a scene without boxes, or with one that moves at once, is
    shown from its first sample.
    """
    start = float(scene.time[0])
    if scene.boxes is None:
        return start
    way = np.linalg.norm(scene.boxes.center - scene.boxes.center[0], axis=-1).max(axis=1)
    moved = np.flatnonzero(way > _MOVED)
    if not len(moved):
        return start
    return max(start, float(scene.time[max(int(moved[0]) - 1, 0)]) - _BEFORE)


def _short(values: Array) -> Any:
    return np.round(values, 4).tolist()
