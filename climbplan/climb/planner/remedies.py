"""Changes of a refused spec that are worth planning with, the likeliest first."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Remedy

_MORE_ROUNDS = (1, 2, 4)
_LARGER = 1.5  # factor on a change that was not enough
_MOST = 16  # changes that are planned with at most
_LIMIT = re.compile(r" (<=|>=|<|>) ")  # in words of a remedy
_RANGE = re.compile(r" from \S+ to \S+")


def candidates(scene: ClimbScene, changes: Sequence[Remedy]) -> Iterator[Remedy]:
    """Changes that have a key of the spec: those that failures named, once more and by half as much
    again, more rounds, and a world without the obstacles.

    changes: as failures named them; their amounts meet what failed there, not what fails next.
    """
    named: dict[tuple[str, str], Remedy] = {}
    keyed = list(dict.fromkeys(c for c in changes if c.key))
    # From what the way to the goal takes at least, where that is known
    asked = [c.value for c in keyed if c.key == "task.rounds" and isinstance(c.value, int)]
    more = []
    if scene.spec.task.rounds != "auto":
        most = max([scene.spec.task.round_count, *asked])
        counts = [most + extra for extra in _MORE_ROUNDS]
        more = [Remedy(f"{count} rounds", "task.rounds", count) for count in counts]
    further = [r for c in keyed if (r := _further(scene, c)) is not None]
    for remedy in [*keyed[:6], *more[:2], *_cleared(scene), *further[:4], *more[2:]]:
        named.setdefault((remedy.key, remedy.yaml), remedy)
    yield from list(named.values())[:_MOST]


def as_tried(remedy: Remedy) -> Remedy:
    """Return a remedy in words that state what was planned with, where they state a limit.

    A limit ("payload <= 2.33 kg") is that of the motion which failed; a plan with the value at the
    limit says nothing of values beyond it.
    """
    words = _LIMIT.sub(" ", remedy.words)
    if isinstance(remedy.value, float):
        words = _RANGE.sub(f" {remedy.value:.4g}", words)
    return remedy if words == remedy.words else replace(remedy, words=f"planned with {words}")


def listed(remedies: Sequence[Remedy]) -> list[str]:
    """Changes in lines, if there are any."""
    if not remedies:
        return []
    head = "with each of these changes a plan was found and verified:"
    return [head, *(f"  {remedy.option}    ({remedy.words})" for remedy in remedies)]


def _cleared(scene: ClimbScene) -> Iterator[Remedy]:
    """Without obstacles: that a plan exists then says that they are in the way."""
    spec = scene.spec.terrain
    if spec.obstacles:
        names = ", ".join(repr(solid.name) for solid in spec.obstacles[:3])
        more = ", ..." if len(spec.obstacles) > 3 else ""
        yield Remedy(f"without {names}{more}", "terrain.obstacles", "[]")


def _further(scene: ClimbScene, remedy: Remedy) -> Remedy | None:
    """The same change half as large again; None where it is no number, or at its end."""
    holder: object = scene.spec
    for name in remedy.key.split("."):
        holder = getattr(holder, name, None)
    if not isinstance(remedy.value, float) or not isinstance(holder, float):
        return None
    value = round(holder + _LARGER * (remedy.value - holder), 4)
    if value < 0 or value == remedy.value:
        return None
    return replace(remedy, words=f"{remedy.key} of {value:g}", value=value)
