"""Masses in planning: a necessary condition of plans with masses, and paces of slow motions.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from climbplan.errors import Conflict, Remedy
from climbplan.limms.scene.limms_scene import GRAVITY, ModuleScene

# Speeds of modules that carry nothing, reduced until contacts bear their loads
PACES = (1.0, 0.5, 0.25, 0.12)


def find_weight_conflicts(scene: ModuleScene) -> tuple[Conflict, ...]:
    """Return why no plan with masses exists if contacts cannot bear a module; empty if they can.

    At the start each module is at rest, and one of its ends alone bears its weight.
    """
    module = scene.module
    weight = module.mass * GRAVITY
    if scene.massless or weight <= module.max_force:
        return ()
    names = ", ".join(scene.module_names)
    comparison = f"a contact holds {module.max_force:g} N, {weight:.1f} N needed"
    reason = f"{comparison}: what each of {names} weighs"
    remedies = (Remedy("modules without mass, as published", "massless", "true"),)
    return (
        Conflict("start", (reason,), remedies, in_words=True, enough=False, names=("load.force",)),
    )
