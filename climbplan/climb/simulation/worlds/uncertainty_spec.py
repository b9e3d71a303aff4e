"""Read the uncertainty of a plan's worlds from its spec and the robot file it names."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.worlds.uncertainty import Distribution, Uncertainty
from climbplan.errors import ClimbplanError
from climbplan.schema.robots.stored import NotKept, build_stored_robot
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


def read_uncertainty(plan: ClimbPlan) -> Uncertainty:
    """Read distributions of a plan's worlds: of its spec, else the robot file, else defaults."""
    document = parse_yaml(plan.spec_text, "spec")
    value = document.value if isinstance(document.value, dict) else {}
    spec = UncertaintySpec.model_validate(value.get("uncertainty") or {})
    robot = RobotUncertaintySpec()
    try:
        stored = build_stored_robot(document, plan.robot_texts).robot
        robot = stored.spec.uncertainty if isinstance(stored, UrdfRobot) else stored.uncertainty
    except (NotKept, ClimbplanError):
        pass  # the plan does not contain its robot's file
    spreads = {}
    for key, quantity, unit in KEYS:
        from_robot = key not in spec.model_fields_set and key in type(robot).model_fields
        spreads[quantity] = _build_distribution(
            getattr(robot if from_robot else spec, key), unit, key
        )
    return Uncertainty(**spreads)


def _build_distribution(stated: Any, unit: float, key: str) -> Distribution:
    if not isinstance(stated, SpreadSpec):
        if key == "backlash_deg":  # a number is the upper end of a uniform distribution
            return Distribution("uniform", 0.0, float(stated) * unit)
        return Distribution("normal", 0.0, float(stated) * unit)
    if stated.uniform is not None:
        low, high = stated.uniform
        return Distribution("uniform", low * unit, high * unit)
    return Distribution("normal", 0.0, float(stated.normal or 0.0) * unit)
