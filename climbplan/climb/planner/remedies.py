"""Candidate changes of an infeasible spec that are worth planning with, the likeliest first."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Remedy

_EXTRA_ROUNDS = (1, 2, 4)
_ENLARGEMENT = 1.5  # factor on a change that was not enough
_MAX_CANDIDATES = 16  # changes that are planned with at most
_LIMIT = re.compile(r" (<=|>=|<|>) ")  # in words of a remedy
_VALUE_RANGE = re.compile(r" from \S+ to \S+")


def generate_candidates(scene: ClimbScene, changes: Sequence[Remedy]) -> Iterator[Remedy]:
    """Yield changes of spec keys: those that failures named, larger ones, more rounds, no
    obstacles.

    Args:
        scene: The climb that has no plan.
        changes: Remedies as failures named them. Their amounts are sufficient for the constraint
            that failed there, not for constraints that fail next.
    """
    unique: dict[tuple[str, str], Remedy] = {}
    keyed = list(dict.fromkeys(c for c in changes if c.key))
    # From what the way to the goal takes at least, where that is known
    required_rounds = [
        c.value for c in keyed if c.key == "task.rounds" and isinstance(c.value, int)
    ]
    round_remedies = []
    if scene.spec.task.rounds != "auto":
        max_rounds = max([scene.spec.task.round_count, *required_rounds])
        counts = [max_rounds + extra for extra in _EXTRA_ROUNDS]
        round_remedies = [Remedy(f"{count} rounds", "task.rounds", count) for count in counts]
    enlarged = [r for c in keyed if (r := _enlarge_change(scene, c)) is not None]
    for remedy in [
        *keyed[:6],
        *round_remedies[:2],
        *_suggest_no_obstacles(scene),
        *enlarged[:4],
        *round_remedies[2:],
    ]:
        unique.setdefault((remedy.key, remedy.yaml), remedy)
    yield from list(unique.values())[:_MAX_CANDIDATES]


def describe_as_planned(remedy: Remedy) -> Remedy:
    """Return a remedy in words that state what was planned with, where they state a limit.

    A limit ("payload <= 2.33 kg") is that of the motion which failed; a plan with the value at the
    limit says nothing of values beyond it.
    """
    description = _LIMIT.sub(" ", remedy.words)
    if isinstance(remedy.value, float):
        description = _VALUE_RANGE.sub(f" {remedy.value:.4g}", description)
    return (
        remedy
        if description == remedy.words
        else replace(remedy, words=f"planned with {description}")
    )


def add_verified_change(headline: str, remedies: Sequence[Remedy]) -> str:
    """Return the first sentence of a failure with the first change that led to a verified plan.

    Args:
        headline: What failed, on one line.
        remedies: Changes with each of which a plan was found and verified, the nearest first.
    """
    if not remedies:
        return headline
    return f"{headline}; a plan was found with {remedies[0].option} ({remedies[0].words})"


def format_remedies(remedies: Sequence[Remedy]) -> list[str]:
    """Return verified changes as lines of a message; an empty list if there are none."""
    if not remedies:
        return []
    head = "with each of these changes a plan was found and verified:"
    return [head, *(f"  {remedy.option}    ({remedy.words})" for remedy in remedies)]


def _suggest_no_obstacles(scene: ClimbScene) -> Iterator[Remedy]:
    """Yield the change that removes all obstacles: a plan without them shows that they block the
    way.
    """
    spec = scene.spec.terrain
    if spec.obstacles:
        names = ", ".join(repr(solid.name) for solid in spec.obstacles[:3])
        ellipsis = ", ..." if len(spec.obstacles) > 3 else ""
        yield Remedy(f"without {names}{ellipsis}", "terrain.obstacles", "[]")


def _enlarge_change(scene: ClimbScene, remedy: Remedy) -> Remedy | None:
    """Return the same change half as large again; None where its value is no number or at its
    bound.
    """
    holder: object = scene.spec
    for name in remedy.key.split("."):
        holder = getattr(holder, name, None)
    if not isinstance(remedy.value, float) or not isinstance(holder, float):
        return None
    value = round(holder + _ENLARGEMENT * (remedy.value - holder), 4)
    if value < 0 or value == remedy.value:
        return None
    return replace(remedy, words=f"{remedy.key} of {value:g}", value=value)
