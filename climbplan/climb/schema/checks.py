"""What must fit together across a climb spec and its robot, which no model can check alone.

Each check needs only some parts, so that a mistake elsewhere does not hide what it finds.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from climbplan.climb.schema.model import (
    CONVEX_METHODS,
    ClimbSpec,
    PosturePlannerSpec,
    SolverSpec,
    TaskSpec,
)
from climbplan.schema.document import Finding, KeyPath, dotted
from climbplan.schema.fields import explain_unknown_key, nearest, slot_at
from climbplan.schema.robots.robot import RobotSpec
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.terrain.terrain import TerrainSpec
from climbplan.schema.wording import findings_of, shown

if TYPE_CHECKING:
    from climbplan.climb.schema.transition import TransitionTaskSpec


@dataclass(frozen=True)
class ClimbParts:
    """The parts of a climb spec that are valid on their own; None where one is not."""

    terrain: TerrainSpec | None
    task: TaskSpec | TransitionTaskSpec | None
    posture: PosturePlannerSpec | None
    solver: SolverSpec | None
    robot: AnyRobot | None


def check_parts(parts: ClimbParts) -> list[Finding]:
    """Everything that does not fit between the parts at hand."""
    return [
        *_limb_names(parts),
        *_limbs_without_region(parts),
        *_method_limits(parts),
        *_grippers(parts),
    ]


def _limb_names(parts: ClimbParts) -> list[Finding]:
    """Limbs named in the task and the terrain exist; the gait moves each of them once."""
    if parts.robot is None:
        return []
    limbs = list(parts.robot.limb_names)
    named: list[tuple[KeyPath, str]] = []
    found: list[Finding] = []
    if parts.task is not None:
        named += [(("task", "start", "toes", name), name) for name in parts.task.start.toes]
        named += [(("task", "goal", "toes", name), name) for name in parts.task.goal.toes]
        named += [(("task", "stance", name), name) for name in parts.task.stance]
        if parts.task is not None and not isinstance(parts.task, TaskSpec):
            named += [(("task", "step_max", name), name) for name in parts.task.step_max]
            named += [(("task", "sequence"), name) for names in parts.task.limbs for name in names]
        gait = (parts.task.gait if isinstance(parts.task, TaskSpec) else None) or ()
        named += [(("task", "gait", i), name) for i, name in enumerate(gait)]
        known = [name for name in gait if name in limbs]
        if gait and len(known) == len(gait) and sorted(known) != sorted(limbs):
            message = f"expected each limb once ({', '.join(limbs)}), got {', '.join(gait)}"
            found.append(Finding(("task", "gait"), message))
    if parts.terrain is not None:
        named += [
            (("terrain", "regions", i, "limbs", j), name)
            for i, region in enumerate(parts.terrain.regions)
            for j, name in enumerate(region.limbs or ())
        ]
        named += [
            (("terrain", "boxes", i, "limbs", j), name)
            for i, box in enumerate(parts.terrain.boxes)
            for j, name in enumerate(box.limbs or ())
        ]
        panel = parts.terrain.panel
        holds = panel.holds if panel is not None else {}
        named += [
            (("terrain", "panel", "holds", hold, "limbs", j), name)
            for hold, spec in holds.items()
            for j, name in enumerate(spec.limbs or ())
        ]
    found += [
        Finding(
            path,
            f"{parts.robot.name} has no limb {name!r}, its limbs are {', '.join(limbs)}",
            nearest(name, limbs),
        )
        for path, name in named
        if name not in limbs
    ]
    return found


def _limbs_without_region(parts: ClimbParts) -> list[Finding]:
    """Every limb may stand somewhere: walls and tubes take all, regions may be picky."""
    terrain = parts.terrain
    if terrain is None or parts.robot is None or terrain.walls or terrain.tube:
        return []
    if terrain.ground is not None or (terrain.scan is not None and terrain.scan.fit):
        return []
    picky = [flat.limbs for flat in terrain.regions] + [box.limbs for box in terrain.boxes]
    if terrain.panel is not None:
        picky += [hold.limbs for hold in terrain.panel.holds.values()]
    return [
        Finding(("terrain", "regions"), f"limb {limb} may use none of the regions")
        for limb in parts.robot.limb_names
        if all(limbs is not None and limb not in limbs for limbs in picky)
    ]


def _method_limits(parts: ClimbParts) -> list[Finding]:
    """What the method cannot state.

    `micp` is convex but for the choice of regions: no curved walls, no lower step bounds, and
    `sl1-relaxation` has its program. The other methods know no grippers, and `nlp` no closed
    linkages.
    """
    if parts.solver is None:
        return []
    if parts.solver.method == "auto":
        return _without_method(parts)
    if parts.solver.method not in ("micp", "nlp"):
        auto = isinstance(parts.task, TaskSpec) and parts.task.rounds == "auto"
        key: KeyPath = ("task", "rounds") if auto else ("solver", "window")
        if auto or parts.solver.window is not None:
            message = f"`{parts.solver.method}` plans a stated number of rounds at once; expected "
            found_by = "`micp`, `nlp` or `auto` for windows"
            return [Finding(key, message + found_by)]
    if parts.solver.method not in CONVEX_METHODS:
        message = _beyond(parts.robot)
        return [Finding(("solver", "method"), message)] if message else []
    cure = f"which `{parts.solver.method}` cannot state"
    if not _only_micp(parts.robot):
        cure += "; use `--method nlp`"
    found = []
    if parts.terrain is not None and parts.terrain.tube is not None:
        found.append(Finding(("terrain", "tube"), f"a curved surface, {cure}"))
    if parts.posture is not None:
        for name, least in (
            ("com_min", parts.posture.steps.com_min),
            ("toe_min", parts.posture.steps.toe_min),
        ):
            if least > 0:
                message = f"a least step size (here {least:g} m) is not convex, {cure}"
                found.append(Finding(("posture", "steps", name), message))
    return found


def _beyond(robot: AnyRobot | None) -> str:
    """Why the robot's limbs or grippers are beyond all methods but `micp`; empty if not."""
    if robot is None:
        return ""
    if robot.gripper is not None:
        return f"{robot.name} has grippers, whose postures only `micp` plans"
    if isinstance(robot, RobotSpec) and robot.five_bar is not None:
        return f"{robot.name} has closed linkages for legs, whose postures only `micp` plans"
    return ""


def _only_micp(robot: AnyRobot | None) -> bool:
    """Whether the robot's limbs or grippers are beyond all other methods."""
    return bool(_beyond(robot))


def _without_method(parts: ClimbParts) -> list[Finding]:
    """What `micp` cannot state, by robots that no other method knows."""
    if not _only_micp(parts.robot):
        return []
    only = (
        "a robot with grippers or closed linkages is planned by `micp`, which has flat terrain and"
    )
    found = []
    if parts.terrain is not None and parts.terrain.tube is not None:
        found.append(Finding(("terrain", "tube"), f"{only} no curved surface"))
    if parts.posture is not None:
        steps = parts.posture.steps
        found += [
            Finding(("posture", "steps", name), f"{only} no least step size")
            for name, least in (("com_min", steps.com_min), ("toe_min", steps.toe_min))
            if least > 0
        ]
    return found


def _grippers(parts: ClimbParts) -> list[Finding]:
    """Robots with grippers climb flat surfaces, with forces of two solvers."""
    if parts.robot is None or parts.robot.gripper is None:
        return []
    name, found = parts.robot.name, []
    if parts.task is not None and not isinstance(parts.task, TaskSpec):
        found.append(Finding(("robot",), f"{name} has grippers, which no transition plans with"))
    if parts.solver is not None and parts.solver.force == "osqp":
        message = f"{name} has grippers, whose forces only `daqp` and `clarabel` plan"
        found.append(Finding(("solver", "force"), message))
    if parts.terrain is not None and parts.terrain.tube is not None:
        found.append(Finding(("terrain", "tube"), f"{name} has grippers, for flat surfaces only"))
    return found


def check_study(spec: ClimbSpec) -> list[Finding]:
    """Every key of the study's grid can be set in this spec, to each of its values."""
    if spec.study is None:
        return []
    data = spec.model_dump(mode="json")
    return [
        finding
        for key, values in spec.study.grid.items()
        for finding in _grid_findings(data, key, values)
    ]


def _grid_findings(data: dict[str, Any], key: str, values: tuple[float, ...]) -> list[Finding]:
    here: KeyPath = ("study", "grid", key)
    path = tuple(int(s) if s.isdecimal() else s for s in key.split("."))
    for length in range(1, len(path) + 1):
        if slot_at(ClimbSpec, path[:length]) is None:
            message, suggestion = explain_unknown_key(ClimbSpec, path[:length])
            return [Finding(here, message, suggestion)]
    slot = slot_at(ClimbSpec, path)
    if slot is None or not slot.is_number or path[0] == "study":
        return [Finding(here, f"expected the dotted key of one number, got {shown(key)}")]
    changed = copy.deepcopy(data)
    holder: Any = changed
    for depth, segment in enumerate(path):
        present = segment in holder if isinstance(holder, dict) else segment in range(len(holder))
        if not present or (depth < len(path) - 1 and holder[segment] is None):
            return [Finding(here, f"this spec has no `{dotted(path[: depth + 1])}`")]
        if depth < len(path) - 1:
            holder = holder[segment]
    found = []
    for i, value in enumerate(values):
        holder[path[-1]] = value
        try:
            ClimbSpec.model_validate(changed)
        except ValidationError as error:
            first = findings_of(error, ClimbSpec)[0]
            found.append(Finding((*here, i), f"as `{dotted(first.path)}`: {first.message}"))
    return found
