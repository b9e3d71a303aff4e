"""The exported gravity torques compared with what Drake says the links weigh."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.simulation.drake.exported import ExportedMotion
from climbplan.simulation.drake.plant import Plant

SAMPLES = 100  # postures that are compared, at most


def gravity_difference(plant: Plant, root: Any, motion: ExportedMotion) -> float:
    """Return the largest difference, as a fraction of the motors' torque limits.

    The robot is at the plan's first sample afterwards.
    """
    context = plant.plant.GetMyMutableContextFromRoot(root)
    limits = np.array([joint.max_torque for joint in motion.joints])
    velocities = [joint.velocity_start() for joint in plant.joints]
    largest = 0.0
    count = min(SAMPLES, len(motion.time))
    for sample in np.linspace(0, len(motion.time) - 1, count).round().astype(int):
        plant.place(context, motion, int(sample))
        bearing = -plant.plant.CalcGravityGeneralizedForces(context)[velocities]
        difference = np.abs(bearing - motion.gravity[sample]) / limits
        largest = max(largest, float(difference.max()))
    plant.place(context, motion, 0)
    return largest
