"""What a plan's spec, and the robot file it names, take for uncertain."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.worlds.uncertainty import Spread, Uncertainty
from climbplan.errors import ClimbplanError
from climbplan.schema.robots.stored import NotKept, stored_robot
from climbplan.schema.robots.uncertainty import RobotUncertaintySpec, SpreadSpec, UncertaintySpec
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.yaml_source import parse_yaml

# Key of a spec, quantity of a world, SI units in one of the key's
KEYS = (
    ("mass", "mass", 1.0),
    ("com_mm", "com", 1e-3),
    ("joint_stiffness", "stiffness", 1.0),
    ("motor_gain", "gain", 1.0),
    ("friction", "friction", 1.0),
    ("surface_mm", "surface", 1e-3),
    ("surface_tilt_deg", "tilt", np.deg2rad(1.0)),
    ("backlash_deg", "backlash", np.deg2rad(1.0)),
    ("toe_placement_mm", "placement", 1e-3),
)


def uncertainty_of(plan: ClimbPlan) -> Uncertainty:
    """Distributions for a plan's worlds: of its spec, else of the robot's file, else defaults."""
    document = parse_yaml(plan.spec_text, plan.name)
    value = document.value if isinstance(document.value, dict) else {}
    stated = UncertaintySpec.model_validate(value.get("uncertainty") or {})
    robot = RobotUncertaintySpec()
    try:
        known = stored_robot(document, plan.robot_texts).robot
        robot = known.spec.uncertainty if isinstance(known, UrdfRobot) else known.uncertainty
    except (NotKept, ClimbplanError):
        pass  # a plan whose robot's file is not at hand: what the spec says, and defaults
    spreads = {}
    for key, quantity, unit in KEYS:
        own = key not in stated.model_fields_set and key in type(robot).model_fields
        spreads[quantity] = _spread(getattr(robot if own else stated, key), unit, key)
    return Uncertainty(**spreads)


def _spread(given: Any, unit: float, key: str) -> Spread:
    if not isinstance(given, SpreadSpec):
        if key == "backlash_deg":  # a number is the most there is
            return Spread("uniform", 0.0, float(given) * unit)
        return Spread("normal", 0.0, float(given) * unit)
    if given.uniform is not None:
        low, high = given.uniform
        return Spread("uniform", low * unit, high * unit)
    return Spread("normal", 0.0, float(given.normal or 0.0) * unit)
