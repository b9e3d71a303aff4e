"""LIMMS spec (`kind: limms`): reconfigurable modules bring a box to its goal (chapter 6).

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from climbplan.limms.schema.space import (
    PlacedBox,
    SpaceDecomposition,
    build_space,
    find_anchor_faults,
    find_block_faults,
    find_stand_faults,
    overlaps,
    reaches_free_space,
)
from climbplan.schema.base import (
    Count,
    Fault,
    Number,
    SpecModel,
    Vector,
    name_field,
    quantity,
    refuse,
)

Behaviour = Literal["arms", "quadruped", "flight"]


class RegionSpec(SpecModel):
    """A box of free space; what no region covers is solid."""

    name: str = name_field("name used in messages")
    lower: Vector = quantity("m", "corner with the least coordinates")
    upper: Vector = quantity("m", "corner with the largest coordinates")


class AnchorSpec(SpecModel):
    """A latch point on a wall or on the ground."""

    name: str = name_field("name used in reports")
    position: Vector = quantity("m", "where it is, on a face of the free space")
    normal: Vector = quantity("", "axis-parallel direction from the face into free space")


class ObstacleSpec(SpecModel):
    """A solid block in the free space; its faces hold anchors, its top may be stood on."""

    name: str = name_field("name used in messages")
    lower: Vector = quantity("m", "corner with the least coordinates")
    upper: Vector = quantity("m", "corner with the largest coordinates")


class SpaceSpec(SpecModel):
    """Free space, obstacles in it, anchors, and friction."""

    friction: Number = quantity("", "friction coefficient of the ground", default=0.8, gt=0)
    regions: tuple[RegionSpec, ...] = Field(min_length=1, description="free space")
    obstacles: tuple[ObstacleSpec, ...] = Field(
        default=(), description="solid blocks in the free space, axis-parallel"
    )
    anchors: tuple[AnchorSpec, ...] = Field(
        default=(), description="anchors on walls, ceilings, obstacles and ground"
    )

    def space(self) -> SpaceDecomposition:
        """Return the free and solid space."""
        return build_space(
            [(r.lower, r.upper) for r in self.regions],
            [(o.name, (o.lower, o.upper)) for o in self.obstacles],
        )


class BoxSpec(SpecModel):
    """A box to deliver, which stays upright and turns about the vertical if its goal says so."""

    size: Vector = quantity("m", "edge lengths along x, y and z")
    mass: Number = quantity("kg", "mass", gt=0)
    start: Vector = quantity("m", "centre at the start, where it stands")
    goal: Vector = quantity("m", "centre at the end")
    start_yaw_deg: Number = quantity(
        "deg",
        "how its edges are turned about the vertical at the start, from x towards y",
        default=0.0,
        ge=-180,
        le=180,
    )
    goal_yaw_deg: Number = quantity(
        "deg", "the same at the end; it turns the near way round", default=0.0, ge=-180, le=180
    )
    arrival_speed: Number = quantity(
        "m/s", "largest speed at which it may arrive; 0: it arrives at rest", default=0.0, ge=0
    )

    @property
    def at_start(self) -> PlacedBox:
        """The placement at the start."""
        return PlacedBox(self.start, self.size, self.start_yaw_deg)

    @property
    def at_goal(self) -> PlacedBox:
        """The placement at the goal."""
        return PlacedBox(self.goal, self.size, self.goal_yaw_deg)

    @property
    def stays(self) -> bool:
        """True if the box is at its goal from the start."""
        turn = (self.goal_yaw_deg - self.start_yaw_deg) % 360
        return self.start == self.goal and turn == 0

    @property
    def is_turned(self) -> bool:
        """True if the edges are off the world axes at the start or the goal."""
        return self.start_yaw_deg != 0 or self.goal_yaw_deg != 0


class ParkedSpec(SpecModel):
    """Another box, which stays where it stands."""

    size: Vector = quantity("m", "edge lengths along x, y and z")
    position: Vector = quantity("m", "its centre")


class StandSpec(SpecModel):
    """A module at the start: it stands upright on the ground, or is latched to an anchor."""

    name: str = name_field("name used in reports")
    position: Vector | None = quantity("m", "point of the ground that it stands on", default=None)
    anchor: str | None = Field(default=None, description="anchor that its first end is latched to")


class DeliverySpec(SpecModel):
    """What plans may use."""

    allow: Annotated[tuple[Behaviour, ...], Field(min_length=1)] = Field(
        default=("arms", "quadruped", "flight"),
        description="how the box may move: held by `arms`, as body of a `quadruped`, in free "
        "`flight` after a throw",
    )


class ConsensusSpec(SpecModel):
    """Method `admm`: the published consensus of a mixed-integer and a nonlinear block."""

    formulation: Literal["improved", "published"] = Field(
        default="improved",
        description="`improved`: intervals as long as the box's mode asks for, reach in the "
        "mixed-integer block, frozen integers; `published`: one second each, reach in the "
        "nonlinear block alone, integers free in every iteration",
    )
    intervals: Count = quantity("", "intervals of the horizon", default=8, ge=3, le=30)
    iterations: Count = quantity("", "iterations at most", default=15, ge=1, le=100)
    weight_growth: Number = quantity(
        "", "factor of the weights from one iteration to the next, rho", default=1.3, gt=1, le=10
    )
    weight: Number = quantity("1/m", "weight of a disagreement at first", default=1.0, gt=0)
    freeze_after: Count = quantity(
        "", "iterations with free integers, then they stay as they are", default=0, ge=0
    )


class LimmsSolverSpec(SpecModel):
    """Method and limits."""

    method: Literal["mode-search", "admm"] = Field(
        default="mode-search",
        description="`mode-search`: search over mode sequences, then a nonlinear program; `admm`: "
        "consensus of a mixed-integer and a nonlinear block, then the same program",
    )
    admm: ConsensusSpec = ConsensusSpec()
    """Method `admm`."""
    max_nlp_solves: Count = quantity(
        "",
        "nonlinear programs that may be solved, of at most 150 iterations each; whatever else is "
        "tried counts as one, too: with the seed they decide what is found, on any machine",
        default=200,
        ge=1,
    )
    time_limit: Number = quantity(
        "s", "a cap of the search, which says if it ended it", default=600.0, gt=0
    )
    max_steps: Count = quantity("", "steps of a quadruped at most", default=16, ge=0, le=60)


class LimmsSpec(SpecModel):
    """Several modules deliver a box."""

    kind: Literal["limms"] = Field(description="always `limms`")
    title: str = Field(default="", description="one line for reports")
    robot: str = Field(
        default="limms", description="built-in module, or path of a `module` file", min_length=1
    )
    massless: bool = Field(
        default=True,
        description="modules have no mass of their own, as in the published model: what they "
        "weigh is told and not judged; false: forces, moments and torques are those of box and "
        "modules together, and plans keep the limits of latches, ground and joints",
    )
    terrain: SpaceSpec
    box: BoxSpec | None = Field(
        default=None, description="the box to deliver; where there are several, `boxes`"
    )
    boxes: Annotated[tuple[BoxSpec, ...], Field(max_length=6)] = Field(
        default=(),
        description="several boxes, brought to their goals in this order; one that is in another's "
        "way is put down elsewhere first",
    )
    static_boxes: tuple[ParkedSpec, ...] = Field(
        default=(), description="boxes that stay as obstacles"
    )
    modules: tuple[StandSpec, ...] = Field(min_length=1, max_length=8, description="the modules")
    task: DeliverySpec = DeliverySpec()
    """What plans may use."""
    solver: LimmsSolverSpec = LimmsSolverSpec()
    """Method and limits."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)

    @property
    def deliveries(self) -> tuple[BoxSpec, ...]:
        """The boxes to deliver, in order."""
        return self.boxes if self.box is None else (self.box,)

    @property
    def delivery_keys(self) -> tuple[str, ...]:
        """The spec key of each box to deliver."""
        return tuple(f"boxes.{i}" for i in range(len(self.boxes))) if self.boxes else ("box",)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        refuse(_find_delivery_faults(self))
        faults = [
            *_find_size_faults(self),
            *_find_name_faults("terrain.regions", [r.name for r in self.terrain.regions]),
            *_find_name_faults("terrain.obstacles", [o.name for o in self.terrain.obstacles]),
            *_find_name_faults("terrain.anchors", [a.name for a in self.terrain.anchors]),
            *_find_name_faults("modules", [m.name for m in self.modules]),
            *_find_module_faults(self),
        ]
        refuse(faults)
        refuse(_find_place_faults(self))
        return self


def _find_delivery_faults(spec: LimmsSpec) -> list[Fault]:
    """Return faults in the list of boxes: one or several, and limits of several."""
    if (spec.box is None) == (not spec.boxes):
        number = "neither" if spec.box is None else "both"
        return [Fault("box", f"expected either `box` or `boxes`, got {number}")]
    faults = [
        Fault(
            f"boxes.{i}.arrival_speed",
            "expected 0: only the last box may arrive with some speed, others have to stay",
        )
        for i, box in enumerate(spec.boxes[:-1])
        if box.arrival_speed > 0
    ]
    faults += [
        Fault(
            f"{key}.{'start' if box.start_yaw_deg else 'goal'}_yaw_deg",
            "expected 0: `admm` does not turn boxes, `mode-search` does",
        )
        for key, box in zip(spec.delivery_keys, spec.deliveries, strict=True)
        if box.is_turned and spec.solver.method == "admm"
    ]
    if len(spec.boxes) < 2:
        return faults
    if spec.solver.method == "admm":
        faults.append(Fault("solver.method", "`admm` delivers one box, expected `mode-search`"))
    if "arms" not in spec.task.allow:
        faults.append(
            Fault("task.allow", "several boxes are delivered by `arms`: expected it here")
        )
    return faults


def _find_size_faults(spec: LimmsSpec) -> list[Fault]:
    """Return faults in sizes and normals."""
    terrain = spec.terrain
    blocks = [(f"terrain.regions.{i}", r.lower, r.upper) for i, r in enumerate(terrain.regions)]
    blocks += [
        (f"terrain.obstacles.{i}", o.lower, o.upper) for i, o in enumerate(terrain.obstacles)
    ]
    faults = [
        Fault(f"{key}.upper", f"expected more than lower {list(lower)}")
        for key, lower, upper in blocks
        if any(high <= low for low, high in zip(lower, upper, strict=True))
    ]
    sized = [
        (f"{key}.size", box.size)
        for key, box in zip(spec.delivery_keys, spec.deliveries, strict=True)
    ]
    sized += [(f"static_boxes.{i}.size", box.size) for i, box in enumerate(spec.static_boxes)]
    faults += [
        Fault(key, f"expected three numbers > 0, got {list(size)}")
        for key, size in sized
        if min(size) <= 0
    ]
    faults += [
        Fault(
            f"terrain.anchors.{i}.normal",
            f"expected a unit vector along an axis, got {list(a.normal)}",
        )
        for i, a in enumerate(spec.terrain.anchors)
        if sorted(abs(v) for v in a.normal) != [0, 0, 1]
    ]
    return faults


def _find_name_faults(key: str, names: list[str]) -> list[Fault]:
    """Return faults for names that occur twice."""
    return [
        Fault(f"{key}.{i}.name", f"names must differ, {name!r} is also number {names.index(name)}")
        for i, name in enumerate(names)
        if names.index(name) < i
    ]


def _find_module_faults(spec: LimmsSpec) -> list[Fault]:
    """Return faults in the placement of modules and in allowed behaviours."""
    faults = []
    anchors = [anchor.name for anchor in spec.terrain.anchors]
    module_of_anchor: dict[str, str] = {}
    for i, module in enumerate(spec.modules):
        if (module.position is None) == (module.anchor is None):
            faults.append(Fault(f"modules.{i}", "expected either `position` or `anchor`"))
        if module.anchor is None:
            continue
        if module.anchor not in anchors:
            names = ", ".join(anchors) or "none"
            expected = f"expected an anchor of the terrain ({names}), got {module.anchor!r}"
            faults.append(Fault(f"modules.{i}.anchor", expected))
        elif module.anchor in module_of_anchor:
            occupied = f"already holds module {module_of_anchor[module.anchor]!r}"
            faults.append(Fault(f"modules.{i}.anchor", occupied))
        module_of_anchor.setdefault(module.anchor, module.name)
    if "arms" not in spec.task.allow and "quadruped" in spec.task.allow and len(spec.modules) < 4:
        shortage = f"a quadruped needs 4 modules, got {len(spec.modules)}"
        faults.append(Fault("modules", shortage))
    if set(spec.task.allow) == {"flight"}:
        faults.append(
            Fault(
                "task.allow",
                "expected `arms` or `quadruped` next to `flight`, which begins from them",
            )
        )
    return faults


def _find_place_faults(spec: LimmsSpec) -> list[Fault]:
    """Return faults in positions of obstacles, boxes, anchors and modules."""
    space = spec.terrain.space()
    regions = [(r.lower, r.upper) for r in spec.terrain.regions]
    faults = [
        Fault(f"terrain.obstacles.{i}", f"obstacle {o.name!r} is nowhere in the free space")
        for i, o in enumerate(spec.terrain.obstacles)
        if not reaches_free_space((o.lower, o.upper), regions)
    ]
    standing: list[tuple[str, PlacedBox]] = []
    ends: list[tuple[str, PlacedBox]] = []
    for key, box in zip(spec.delivery_keys, spec.deliveries, strict=True):
        faults += find_block_faults(f"{key}.start", "the box at its start", box.at_start, space)
        faults += find_block_faults(f"{key}.goal", "the box at its goal", box.at_goal, space)
        standing.append((f"{key}.start", box.at_start))
        ends.append((f"{key}.goal", box.at_goal))
    for i, parked in enumerate(spec.static_boxes):
        key, place = f"static_boxes.{i}.position", PlacedBox(parked.position, parked.size)
        faults += find_block_faults(key, f"static box {i}", place, space)
        standing.append((key, place))
    for i, (key, place) in enumerate(standing):
        for other_key, other_place in standing[:i]:
            if overlaps(place, other_place):
                faults.append(Fault(key, f"overlaps the box at {other_key}"))
    for i, (key, place) in enumerate(ends):
        for number, parked in enumerate(spec.static_boxes):
            if overlaps(place, PlacedBox(parked.position, parked.size)):
                faults.append(Fault(key, f"inside static box {number}"))
        for other_key, other_place in ends[:i]:
            if overlaps(place, other_place):
                faults.append(Fault(key, f"overlaps the box at {other_key}"))
    if spec.box is not None and spec.box.stays:
        faults.append(Fault("box.goal", "expected another place than the start of the box"))
    if spec.boxes and all(box.stays for box in spec.boxes):
        faults.append(Fault("boxes", "expected a box whose goal is not its start"))
    for i, anchor in enumerate(spec.terrain.anchors):
        key = f"terrain.anchors.{i}.position"
        same = [a.name for a in spec.terrain.anchors[:i] if a.position == anchor.position]
        faults += [Fault(key, f"anchor {name!r} is at the same place") for name in same]
        faults += find_anchor_faults(key, anchor.name, anchor.position, anchor.normal, space)
    for i, module in enumerate(spec.modules):
        if module.position is not None:
            faults += find_stand_faults(
                f"modules.{i}.position", module.name, module.position, space
            )
    for key, ((x, y, z), (_, _, height), _) in [*standing, *ends[:-1]]:
        bottom = (x, y, z - height / 2)
        faults += find_stand_faults(key, "the box", bottom, space)
    return faults
