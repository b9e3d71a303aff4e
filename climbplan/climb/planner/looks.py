"""How the robot of a plan looks, for those who draw it."""

from __future__ import annotations

import logging

from climbplan.robots.looks import Looks
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.robots.urdf.robot import UrdfRobot

_log = logging.getLogger(__name__)


def load_visual_geometry(spec: AnyRobot, robot: Robot, max_triangles: int | None = None) -> Looks | None:
    """The visual geometry that a plan carries; None for robots that are drawn from their numbers.

    most: triangles of one shape, in place of those of a plan. What cannot be read is told: nothing
    that is planned rests on it.
    """
    if not isinstance(spec, UrdfRobot):
        return None
    # Here, for plans of other robots need nothing that reads meshes
    from climbplan.robots.urdf.visuals import VisualGeometryError, read_visual_geometry

    try:
        return read_visual_geometry(spec, robot) if max_triangles is None else read_visual_geometry(spec, robot, max_triangles)
    except VisualGeometryError as error:
        _log.warning("%s is drawn as capsules: %s", spec.name, error)
        return None
