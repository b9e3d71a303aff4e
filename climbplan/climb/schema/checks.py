"""Checks of consistency across a climb spec and its robot, which no single model can make.

Each check needs only some parts of the spec, so that a mistake elsewhere does not hide its
findings.
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
from climbplan.schema.document import Finding, KeyPath, format_key_path
from climbplan.schema.fields import explain_unknown_key, find_closest_name, find_slot
from climbplan.schema.robots.robot import RobotSpec
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.terrain.terrain import TerrainSpec
from climbplan.schema.wording import collect_findings, format_value

if TYPE_CHECKING:
    from climbplan.climb.schema.transition import TransitionSpec, TransitionTaskSpec

_LEAST_RISK = 0.004  # of falls in closed loop: what 1000 worlds without a fall show


@dataclass(frozen=True)
class ValidClimbParts:
    """The parts of a climb spec that are valid on their own; None where one is not."""

    terrain: TerrainSpec | None
    task: TaskSpec | TransitionTaskSpec | None
    posture: PosturePlannerSpec | None
    solver: SolverSpec | None
    robot: AnyRobot | None


def check_parts(climb_parts: ValidClimbParts) -> list[Finding]:
    """Return all inconsistencies between the valid parts."""
    return [
        *_check_limb_names(climb_parts),
        *_find_limbs_without_region(climb_parts),
        *_check_method(climb_parts),
        *_check_grippers(climb_parts),
    ]


def _check_limb_names(climb_parts: ValidClimbParts) -> list[Finding]:
    """Check that limbs named in task and terrain exist, and that the gait moves each once."""
    if climb_parts.robot is None:
        return []
    limbs = list(climb_parts.robot.limb_names)
    mentions: list[tuple[KeyPath, str]] = []
    findings: list[Finding] = []
    if climb_parts.task is not None:
        mentions += [
            (("task", "start", "toes", name), name) for name in climb_parts.task.start.toes
        ]
        mentions += [(("task", "goal", "toes", name), name) for name in climb_parts.task.goal.toes]
        mentions += [(("task", "stance", name), name) for name in climb_parts.task.stance]
        if climb_parts.task is not None and not isinstance(climb_parts.task, TaskSpec):
            mentions += [(("task", "step_max", name), name) for name in climb_parts.task.step_max]
            mentions += [
                (("task", "sequence"), name) for names in climb_parts.task.limbs for name in names
            ]
        gait = (climb_parts.task.gait if isinstance(climb_parts.task, TaskSpec) else None) or ()
        mentions += [(("task", "gait", i), name) for i, name in enumerate(gait)]
        existing = [name for name in gait if name in limbs]
        if gait and len(existing) == len(gait) and sorted(existing) != sorted(limbs):
            message = f"expected each limb once ({', '.join(limbs)}), got {', '.join(gait)}"
            findings.append(Finding(("task", "gait"), message))
    if climb_parts.terrain is not None:
        mentions += [
            (("terrain", "regions", i, "limbs", j), name)
            for i, region in enumerate(climb_parts.terrain.regions)
            for j, name in enumerate(region.limbs or ())
        ]
        mentions += [
            (("terrain", "boxes", i, "limbs", j), name)
            for i, box in enumerate(climb_parts.terrain.boxes)
            for j, name in enumerate(box.limbs or ())
        ]
        panel = climb_parts.terrain.panel
        holds = panel.holds if panel is not None else {}
        mentions += [
            (("terrain", "panel", "holds", hold, "limbs", j), name)
            for hold, spec in holds.items()
            for j, name in enumerate(spec.limbs or ())
        ]
    findings += [
        Finding(
            path,
            f"{climb_parts.robot.name} has no limb {name!r}, its limbs are {', '.join(limbs)}",
            find_closest_name(name, limbs),
        )
        for path, name in mentions
        if name not in limbs
    ]
    return findings


def _find_limbs_without_region(climb_parts: ValidClimbParts) -> list[Finding]:
    """Return findings for limbs that may stand nowhere; walls and tubes admit all limbs."""
    terrain = climb_parts.terrain
    if terrain is None or climb_parts.robot is None or terrain.walls or terrain.tube:
        return []
    if terrain.ground is not None or (terrain.scan is not None and terrain.scan.fit):
        return []
    restrictions = [flat.limbs for flat in terrain.regions] + [box.limbs for box in terrain.boxes]
    if terrain.panel is not None:
        restrictions += [hold.limbs for hold in terrain.panel.holds.values()]
    return [
        Finding(("terrain", "regions"), f"limb {limb} may use none of the regions")
        for limb in climb_parts.robot.limb_names
        if all(limbs is not None and limb not in limbs for limbs in restrictions)
    ]


def _check_method(climb_parts: ValidClimbParts) -> list[Finding]:
    """Return findings for requirements that the method cannot state.

    `micp` is convex except for the choice of regions: it takes no curved walls and no lower step
    bounds. `sl1-relaxation` has the same program. The other methods take no grippers, and `nlp` no
    closed linkages.
    """
    if climb_parts.solver is None:
        return []
    if climb_parts.solver.method == "auto":
        return _check_micp_only(climb_parts)
    if climb_parts.solver.method == "contact-search":
        return _check_contact_search(climb_parts)
    if climb_parts.solver.method not in ("micp", "nlp"):
        auto = isinstance(climb_parts.task, TaskSpec) and climb_parts.task.rounds == "auto"
        key: KeyPath = ("task", "rounds") if auto else ("solver", "window")
        if auto or climb_parts.solver.window is not None:
            message = (
                f"`{climb_parts.solver.method}` plans a stated number of rounds at once; expected "
            )
            suggested_methods = "`micp`, `nlp` or `auto` for windows"
            return [Finding(key, message + suggested_methods)]
    if climb_parts.solver.method not in CONVEX_METHODS:
        message = _explain_micp_only(climb_parts.robot)
        return [Finding(("solver", "method"), message)] if message else []
    suggestion = f"method `{climb_parts.solver.method}` cannot state"
    if not _is_micp_only(climb_parts.robot):
        suggestion += "; use `--method nlp`"
    findings = []
    if climb_parts.terrain is not None and climb_parts.terrain.tube is not None:
        findings.append(Finding(("terrain", "tube"), f"a curved surface, which {suggestion}"))
    if climb_parts.posture is not None:
        for name, min_step in (
            ("com_min", climb_parts.posture.steps.com_min),
            ("toe_min", climb_parts.posture.steps.toe_min),
        ):
            if min_step > 0:
                message = f"a smallest step of {min_step:g} m is not convex, and {suggestion} it"
                findings.append(Finding(("posture", "steps", name), message))
    return findings


def _check_contact_search(climb_parts: ValidClimbParts) -> list[Finding]:
    """Return findings for what `contact-search` cannot state.

    A stated number of rounds passes, as that of a plan that it made; planned it is refused.
    """
    findings = []
    subject = "method `contact-search`"
    if climb_parts.robot is not None and climb_parts.robot.gripper is not None:
        message = f"{subject} plans toes that press; {climb_parts.robot.name} has grippers"
        findings.append(Finding(("solver", "method"), message))
    if climb_parts.terrain is not None and climb_parts.terrain.tube is not None:
        message = f"{subject} needs flat contact regions; use `--method nlp` in a tube"
        findings.append(Finding(("terrain", "tube"), message))
    if climb_parts.posture is not None:
        steps = climb_parts.posture.steps
        findings += [
            Finding(("posture", "steps", name), f"{subject} has no smallest step; expected 0")
            for name, min_step in (("com_min", steps.com_min), ("toe_min", steps.toe_min))
            if min_step > 0
        ]
    return findings


def _explain_micp_only(robot: AnyRobot | None) -> str:
    """Explain why only `micp` plans the robot's limbs or grippers; return "" if others do too."""
    if robot is None:
        return ""
    if robot.gripper is not None:
        return f"{robot.name} has grippers, whose postures only `micp` plans"
    if isinstance(robot, RobotSpec) and robot.five_bar is not None:
        return f"{robot.name} has closed linkages for legs, whose postures only `micp` plans"
    return ""


def _is_micp_only(robot: AnyRobot | None) -> bool:
    """Return whether only `micp` plans the robot's limbs or grippers."""
    return bool(_explain_micp_only(robot))


def _check_micp_only(climb_parts: ValidClimbParts) -> list[Finding]:
    """Return findings for what `micp` cannot state, for robots that only `micp` plans."""
    if not _is_micp_only(climb_parts.robot):
        return []
    reason = (
        "a robot with grippers or closed linkages is planned by `micp`, which has flat terrain and"
    )
    findings = []
    if climb_parts.terrain is not None and climb_parts.terrain.tube is not None:
        findings.append(Finding(("terrain", "tube"), f"{reason} no curved surface"))
    if climb_parts.posture is not None:
        steps = climb_parts.posture.steps
        findings += [
            Finding(("posture", "steps", name), f"{reason} no smallest step")
            for name, min_step in (("com_min", steps.com_min), ("toe_min", steps.toe_min))
            if min_step > 0
        ]
    return findings


def _check_grippers(climb_parts: ValidClimbParts) -> list[Finding]:
    """Return findings for grippers on curved surfaces, in transitions, or with `osqp`."""
    if climb_parts.robot is None or climb_parts.robot.gripper is None:
        return []
    name, findings = climb_parts.robot.name, []
    if climb_parts.task is not None and not isinstance(climb_parts.task, TaskSpec):
        findings.append(
            Finding(
                ("robot",),
                f"{name} has grippers: expected a robot without grippers for a transition",
            )
        )
    if climb_parts.solver is not None and climb_parts.solver.force_solver == "osqp":
        message = f"{name} has grippers, whose forces only `daqp` and `clarabel` plan"
        findings.append(Finding(("solver", "force_solver"), message))
    if climb_parts.terrain is not None and climb_parts.terrain.tube is not None:
        findings.append(
            Finding(("terrain", "tube"), f"{name} has grippers: expected flat surfaces")
        )
    return findings


def check_risk(spec: ClimbSpec | TransitionSpec, robot: AnyRobot) -> list[Finding]:
    """Check that falls can be counted, in closed loop where that is requested."""
    if spec.risk is not None and spec.trajectory.pace is not None:
        message = "expected no `trajectory.pace`: falls are counted by steps that know no inertia"
        if spec.closed_loop:
            message = "expected no `trajectory.pace`: closed-loop execution measures forces at rest"
        return [Finding(("risk",), message)]
    if not spec.closed_loop:
        return []
    if spec.risk is None:
        return [Finding(("closed_loop",), "expected `risk` as well, whose falls are counted so")]
    if spec.risk < _LEAST_RISK:
        message = f"expected at least {_LEAST_RISK}: closed-loop worlds that show less take days"
        return [Finding(("risk",), message)]
    has_five_bars = isinstance(robot, RobotSpec) and robot.five_bar is not None
    has_soles = not isinstance(robot, RobotSpec) and robot.spec.flat_feet
    if robot.gripper is not None or has_five_bars or has_soles:
        message = (
            f"{robot.name} has five-bar legs, grippers or flat feet, which closed-loop execution "
            "does not know"
        )
        return [Finding(("closed_loop",), message)]
    return []


def check_study(spec: ClimbSpec) -> list[Finding]:
    """Check that every key of the study's grid can be set in this spec, to each of its values."""
    if spec.study is None:
        return []
    data = spec.model_dump(mode="json")
    return [
        finding
        for key, values in spec.study.grid.items()
        for finding in _check_grid_key(data, key, values)
    ]


def _check_grid_key(data: dict[str, Any], key: str, values: tuple[float, ...]) -> list[Finding]:
    """Check one key of the study's grid with its values."""
    grid_path: KeyPath = ("study", "grid", key)
    path = tuple(int(s) if s.isdecimal() else s for s in key.split("."))
    for length in range(1, len(path) + 1):
        if find_slot(ClimbSpec, path[:length]) is None:
            message, suggestion = explain_unknown_key(ClimbSpec, path[:length])
            return [Finding(grid_path, message, suggestion)]
    slot = find_slot(ClimbSpec, path)
    if slot is None or not slot.is_number or path[0] == "study":
        return [
            Finding(grid_path, f"expected the dotted key of one number, got {format_value(key)}")
        ]
    changed = copy.deepcopy(data)
    holder: Any = changed
    for depth, segment in enumerate(path):
        present = segment in holder if isinstance(holder, dict) else segment in range(len(holder))
        if not present or (depth < len(path) - 1 and holder[segment] is None):
            return [Finding(grid_path, f"this spec has no `{format_key_path(path[: depth + 1])}`")]
        if depth < len(path) - 1:
            holder = holder[segment]
    findings = []
    for i, value in enumerate(values):
        holder[path[-1]] = value
        try:
            ClimbSpec.model_validate(changed)
        except ValidationError as error:
            first_finding = collect_findings(error, ClimbSpec)[0]
            findings.append(
                Finding(
                    (*grid_path, i),
                    f"as `{format_key_path(first_finding.path)}`: {first_finding.message}",
                )
            )
    return findings
