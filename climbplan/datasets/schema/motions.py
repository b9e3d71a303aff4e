"""Datasets of motions: scenes drawn for robots, planned, verified, simulated and exported."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import (
    Count,
    Fault,
    Interval,
    Number,
    SpecModel,
    Vector,
    quantity,
    refuse,
)

MODEL_ENDINGS = (".urdf", ".xml", ".mjcf", ".xacro")  # of robots that are proposed
ROBOT_ENDINGS = (".yaml", ".yml")
_SMALL_TILT = 45.0  # [deg] beyond, nothing stands
_SHORTEST = 0.05  # [m] of a tread


def _interval(unit: str, description: str, default: Interval) -> Interval:
    """Return the field of a range that a value of each row is drawn from."""
    field: Interval = quantity(unit, f"{description}, from and to", default=default)
    return field


class SceneSpec(SpecModel):
    """What all scenes on ground share."""

    friction: Interval = _interval("", "friction coefficient", (0.7, 1.0))

    @model_validator(mode="after")
    def _check_ranges(self) -> Self:
        faults = [
            Fault(name, f"expected the smaller number first, got {list(value)}")
            for name in type(self).model_fields
            if isinstance(value := getattr(self, name), tuple) and value[0] > value[1]
        ]
        if not self.friction[0] > 0:
            faults.append(Fault("friction", f"expected numbers > 0, got {list(self.friction)}"))
        refuse([*faults, *self._list_faults()])
        return self

    def _list_faults(self) -> list[Fault]:
        return []

    def _require_within(self, name: str, low: float, high: float) -> list[Fault]:
        """Return a fault of a range that leaves another one."""
        value = getattr(self, name)
        if low <= value[0] and value[1] <= high:
            return []
        return [Fault(name, f"expected numbers from {low:g} to {high:g}, got {list(value)}")]


class StairsSceneSpec(SceneSpec):
    """Stairs up."""

    family: Literal["stairs"] = Field(description="always `stairs`")
    rise: Interval = _interval("m", "height of a step", (0.05, 0.15))
    run: Interval = _interval("m", "depth of a step", (0.25, 0.35))
    steps: tuple[Count, Count] = quantity("", "number of steps, from and to", default=(2, 5))

    def _list_faults(self) -> list[Fault]:
        return [
            *self._require_within("rise", 0.0, 0.5),
            *self._require_within("run", _SHORTEST, 5.0),
            *self._require_within("steps", 1, 100),
        ]


class BlocksSceneSpec(SceneSpec):
    """Blocks across the way, each higher or lower than the floor."""

    family: Literal["steps"] = Field(description="always `steps`: up and down")
    height: Interval = _interval(
        "m", "largest height of a block over or below the floor", (0.0, 0.08)
    )
    run: Interval = _interval("m", "depth of a block", (0.25, 0.5))
    steps: tuple[Count, Count] = quantity("", "number of blocks, from and to", default=(2, 4))

    def _list_faults(self) -> list[Fault]:
        return [
            *self._require_within("height", 0.0, 0.5),
            *self._require_within("run", _SHORTEST, 5.0),
            *self._require_within("steps", 1, 100),
        ]


class SlopeSceneSpec(SceneSpec):
    """A slope up or down."""

    family: Literal["slope"] = Field(description="always `slope`")
    angle_deg: Interval = _interval("deg", "angle; negative ones go down", (-12.0, 12.0))
    length: Interval = _interval("m", "level length of the slope", (0.6, 1.2))

    def _list_faults(self) -> list[Fault]:
        return [
            *self._require_within("angle_deg", -_SMALL_TILT, _SMALL_TILT),
            *self._require_within("length", _SHORTEST, 20.0),
        ]


class StonesSceneSpec(SceneSpec):
    """Stepping stones, six in a row, apart from each other."""

    family: Literal["stones"] = Field(description="always `stones`")
    rows: tuple[Count, Count] = quantity("", "rows of stones, from and to", default=(2, 5))
    size: Interval = _interval("m", "side of a stone", (0.14, 0.2))

    def _list_faults(self) -> list[Fault]:
        return [
            *self._require_within("rows", 1, 100),
            *self._require_within("size", 0.02, 0.22),
        ]


class RubbleSceneSpec(SceneSpec):
    """Inclined blocks of uneven height."""

    family: Literal["rubble"] = Field(description="always `rubble`")
    rows: tuple[Count, Count] = quantity("", "rows of twelve blocks, from and to", default=(4, 8))
    height: Interval = _interval("m", "heights of the blocks", (-0.03, 0.06))
    tilt_deg: Number = quantity("deg", "tilts either way, at most", default=8.0, ge=0, le=30)

    def _list_faults(self) -> list[Fault]:
        return [
            *self._require_within("rows", 1, 100),
            *self._require_within("height", -0.25, 0.5),
        ]


class ScansSceneSpec(SceneSpec):
    """Meshes of a folder, one drawn for each row; z up, the way along y from the origin."""

    family: Literal["scans"] = Field(description="always `scans`")
    folder: str = Field(min_length=1, description="folder of meshes (.stl, .obj, .ply)")
    length: Interval = _interval("m", "length of the way", (0.5, 1.0))

    def _list_faults(self) -> list[Fault]:
        return self._require_within("length", _SHORTEST, 100.0)


class SpecSceneSpec(SpecModel):
    """A spec of any kind that moves one robot, with numbers of it drawn: chimneys, walks, walls."""

    family: Literal["spec"] = Field(description="always `spec`")
    file: str = Field(
        min_length=1, description="spec of kind `climb`, `transition` or `mpc`, with its own robot"
    )
    ranges: dict[str, Interval] = Field(
        default_factory=dict,
        description="keys of the spec, such as `terrain.walls.gap`, each with a range that its "
        "number is drawn from",
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> Self:
        refuse(
            [
                Fault(f"ranges.{key}", f"expected the smaller number first, got {list(value)}")
                for key, value in self.ranges.items()
                if value[0] > value[1]
            ]
        )
        return self


GroundScene = (
    StairsSceneSpec
    | BlocksSceneSpec
    | SlopeSceneSpec
    | StonesSceneSpec
    | RubbleSceneSpec
    | ScansSceneSpec
)
AnyScene = Annotated[GroundScene | SpecSceneSpec, Field(discriminator="family")]


class MotionRobotSpec(SpecModel):
    """A robot that walks over the drawn grounds."""

    file: str = Field(
        min_length=1,
        description="built-in robot, or path of a robot YAML, a URDF or an MJCF; of the latter two "
        "a robot is proposed, as by `climbplan new robot`",
    )
    height: Number | None = quantity(
        "m", "body over its footholds; left out: that of its standing posture", default=None, gt=0
    )
    stance: dict[str, Vector] | None = quantity(
        "m", "footholds in the body's frame by limb; left out: the standing posture", default=None
    )
    step: Number = quantity(
        "of height", "longest step of the body; toes take four times that", default=0.4, gt=0, le=2
    )
    speed: Number = quantity("m/s", "of the body", default=0.02, gt=0, le=5)


class MotionSolverSpec(SpecModel):
    """Limits of a row; method and tolerances of scenes from specs are those of the specs."""

    method: Literal["automatic"] = Field(
        default="automatic", description="`automatic`: as the planner selects it for each scene"
    )
    time_limit: Number = quantity(
        "s",
        "of planning; rows that it ends are none, as they would depend on the machine",
        default=300.0,
        gt=0,
    )


class MotionsProblemSpec(SpecModel):
    """Scenes of several families, each for one robot, and the motions that are planned in them."""

    kind: Literal["motions"] = Field(description="always `motions`")
    robots: tuple[MotionRobotSpec, ...] = Field(
        default=(), description="robots that walk over the drawn grounds"
    )
    scenes: tuple[AnyScene, ...] = Field(min_length=1, description="families that rows draw from")
    rate: Number = quantity("Hz", "sample rate of the motions", default=50.0, gt=0, le=2000)
    pace: Literal["planned", "fastest", "dynamic"] = Field(
        default="planned",
        description="`planned`: the speed of the plan; `fastest`: climbs of robots from URDFs are "
        "played as fast as inverse dynamics allow and they stand in MuJoCo without a slip, with "
        "contact forces solved again; `dynamic`: climbs are planned with `trajectory.pace: "
        "fastest`, so that each part of a motion is as fast as its own dynamics allow",
    )
    plans: bool = Field(
        default=True, description="whether a plan file is kept beside each motion, for films"
    )
    solver: MotionSolverSpec = MotionSolverSpec()
    """Limits."""

    @model_validator(mode="after")
    def _robots_for_grounds(self) -> Self:
        on_ground = [s.family for s in self.scenes if not isinstance(s, SpecSceneSpec)]
        faults = []
        if on_ground and not self.robots:
            faults.append(Fault("robots", f"expected a robot for the scenes of `{on_ground[0]}`"))
        if self.robots and not on_ground:
            faults.append(Fault("robots", "expected none: scenes from specs name their own robot"))
        refuse(faults)
        return self
