"""Which scenes the contact search can plan, and where it is tried first."""

from __future__ import annotations

from climbplan.climb.scene.climb_scene import ClimbScene

GROUND_COSINE = 0.7  # smallest upward part of the normal of ground


def starts_on_ground(scene: ClimbScene) -> bool:
    """Return whether all limbs start on ground, rather than on walls."""
    surfaces = scene.terrain.surfaces
    normals = [
        surfaces[int(region)].normal_at(toe)
        for region, toe in zip(scene.start.region, scene.start.toes, strict=True)
    ]
    return min(float(normal[2]) for normal in normals) >= GROUND_COSINE


def find_obstacle_to_method(scene: ClimbScene) -> str | None:
    """Return what the method plans instead of what the scene asks for; None where it can plan it.

    The spec's checks state the same by key; flat feet are known of the built robot alone.
    """
    steps = scene.spec.posture.steps
    if scene.spec.task.rounds != "auto":
        return "as many rounds as are needed: write `task.rounds: auto`"
    if scene.terrain.is_curved:
        return "on flat contact regions: use --method nlp in a tube"
    if scene.robot.sole is not None:
        return "spherical feet and points, not flat feet"
    if scene.grippers is not None:
        return "toes that press, not grippers"
    if steps.com_min > 0 or steps.toe_min > 0:
        return "steps without lower bounds (com_min, toe_min)"
    return None
