"""Datasets of walks (chapter 8.2.4.5): random starts of a walking task, each solved.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Count, Fault, Interval, Number, SpecModel, quantity, refuse
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.task import WalkTaskSpec, WalkWeightsSpec
from climbplan.walking.schema.terrain import WalkTerrainSpec


class StartRangesSpec(SpecModel):
    """How far starts are drawn either way: the published ranges, and disturbances beyond them."""

    forward: Number = quantity("m/s", "v_x, published", default=1.5, ge=0, le=10)
    acceleration: Number = quantity(
        "m/s^2", "a_x, published: a push through the knot before the walk", 15.0, ge=0, le=100
    )
    lateral: Number = quantity("m/s", "v_y", default=0.5, ge=0, le=10)
    tilt: Number = quantity("rad", "roll and pitch", default=0.1, ge=0, le=1)
    yaw: Number = quantity("rad", "yaw", default=0.0, ge=0, le=1.5)
    angular_velocity: Number = quantity(
        "rad/s", "components of the angular velocity", 0.6, ge=0, le=10
    )
    toes: Number = quantity("m", "toes along x and y", default=0.04, ge=0, le=0.2)


class WorldRangesSpec(SpecModel):
    """Robots, speeds and ground drawn for each walk; left out they are as the spec says."""

    mass: Number = quantity(
        "", "share of the mass either way; the inertia goes with it", default=0.0, ge=0, lt=1
    )
    speed: Interval | None = quantity(
        "", "share of the reference's velocity, from and to; left out: all of it", default=None
    )
    rise: Number = quantity(
        "m",
        "from one tread across the way to the next, up or down; 0: flat ground",
        default=0.0,
        ge=0,
        le=0.2,
    )
    tread: Interval = quantity("m", "lengths of treads, from and to", default=(0.2, 0.5))

    @model_validator(mode="after")
    def _lengths(self) -> Self:
        faults = []
        low, high = self.tread
        if not 0.05 <= low <= high <= 5.0:
            message = f"expected lengths from 0.05 to 5, the shorter first, got {[low, high]}"
            faults.append(Fault("tread", message))
        slow, fast = self.speed or (1.0, 1.0)
        if not 0.0 <= slow <= fast <= 2.0:
            message = f"expected shares from 0 to 2, the lesser first, got {[slow, fast]}"
            faults.append(Fault("speed", message))
        refuse(faults)
        return self


class WalkRowSolverSpec(SpecModel):
    """Method and limits of a row."""

    method: Literal["gait-search", "mpcc"] = Field(
        default="gait-search", description="`gait-search` or `mpcc`, as of `kind: mpc`"
    )
    max_qp_solves: Count = quantity("", "QPs that the search may solve", default=400, ge=1)
    time_limit: Number = quantity(
        "s",
        "cap of a row; a row that it ended is none, as its answer would depend on the machine",
        default=120.0,
        gt=0,
    )


class WalksProblemSpec(SpecModel):
    """Random starts of a walking task, on flat ground or in worlds that are drawn, too."""

    kind: Literal["mpc"] = Field(description="always `mpc`")
    robot: str = Field(
        default="scaler",
        min_length=1,
        description="built-in rigid body (`scaler`) or path of a rigid-body YAML file",
    )
    terrain: WalkTerrainSpec = WalkTerrainSpec()
    """The ground: its friction."""
    task: WalkTaskSpec = WalkTaskSpec()
    """Horizon and reference; the start is drawn."""
    weights: WalkWeightsSpec = WalkWeightsSpec()
    """The objective."""
    start: StartRangesSpec = StartRangesSpec()
    """What starts are drawn from."""
    randomisation: WorldRangesSpec = WorldRangesSpec()
    """What robots, speeds and ground are drawn from."""
    solver: WalkRowSolverSpec = WalkRowSolverSpec()
    """Method and limits."""

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        faults = []
        if self.terrain.regions:
            message = (
                "walks of a dataset are on flat ground, or on treads of height "
                "`problem.randomisation.rise`: leave this out"
            )
            faults.append(Fault("terrain.regions", message))
        if 2 * (self.terrain.edge or 0.0) >= self.randomisation.tread[0]:
            faults.append(Fault("terrain.edge", "expected less than half of the shortest tread"))
        if self.task.knots < 5:
            faults.append(
                Fault(
                    "task.knots",
                    f"expected at least 5 knots, which a section has, got {self.task.knots}",
                )
            )
        refuse(faults)
        return self

    @property
    def walk(self) -> MpcSpec:
        """The walking task that starts are drawn for."""
        return MpcSpec(
            kind="mpc",
            robot=self.robot,
            terrain=self.terrain,
            task=self.task,
            weights=self.weights,
        )
