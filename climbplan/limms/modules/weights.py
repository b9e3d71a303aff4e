"""Masses in planning: what no plan with masses escapes, and how calm ways without the box are."""

from __future__ import annotations

from climbplan.errors import Conflict, Remedy
from climbplan.limms.scene.limms_scene import GRAVITY, Scene

# Ways of modules that carry nothing are made so much slower until what they ask for is held
PACES = (1.0, 0.5, 0.25, 0.12)


def too_heavy(scene: Scene) -> tuple[Conflict, ...]:
    """Why no plan with masses exists, if what every module stands or hangs on cannot hold it.

    At the start each module is at rest and one of its ends alone bears its weight.
    """
    module = scene.module
    weight = module.mass * GRAVITY
    if scene.massless or weight <= module.max_force:
        return ()
    names = ", ".join(scene.module_names)
    holds = f"a contact holds {module.max_force:g} N, {weight:.1f} N needed"
    words = f"{holds}: what each of {names} weighs"
    remedies = (Remedy("modules without mass, as published", "massless", "true"),)
    return (
        Conflict("start", (words,), remedies, in_words=True, enough=False, names=("load.force",)),
    )
