"""The visual geometry of a plan's robot, for drawing."""

from __future__ import annotations

import logging

from climbplan.robots.model import Robot
from climbplan.robots.visual_geometry import VisualGeometry
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.robots.urdf.robot import UrdfRobot

_log = logging.getLogger(__name__)


def load_visual_geometry(
    spec: AnyRobot, robot: Robot, max_triangles: int | None = None
) -> VisualGeometry | None:
    """Return the visual geometry that a plan carries; None for robots drawn as capsules.

    Geometry that cannot be read is logged only, because no part of planning depends on it.

    Args:
        spec: The robot as its spec states it.
        robot: The same robot as a model.
        max_triangles: Largest number of triangles of one shape; None for that of plans.
    """
    if not isinstance(spec, UrdfRobot):
        return None
    # Here, for plans of other robots need nothing that reads meshes
    from climbplan.robots.urdf.visuals import VisualGeometryError, read_visual_geometry

    try:
        return (
            read_visual_geometry(spec, robot)
            if max_triangles is None
            else read_visual_geometry(spec, robot, max_triangles)
        )
    except VisualGeometryError as error:
        _log.warning("%s is drawn as capsules: %s", spec.name, error)
        return None
