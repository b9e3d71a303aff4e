"""MPC spec (`kind: mpc`): a walking quadruped that chooses footsteps, gait and forces (8.2)."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.spec.base import Count, Fault, Interval, Number, SpecModel, Vector, quantity, refuse

Pair = tuple[Number, Number]


class LevelRegionSpec(SpecModel):
    """A level rectangle that toes may stand on."""

    name: str = Field(min_length=1, description="name used in reports")
    x: Interval = quantity("m", "extent along x, from and to")
    y: Interval = quantity("m", "extent along y, from and to")
    height: Number = quantity("m", "height of the surface", default=0.0)

    @model_validator(mode="after")
    def _extents(self) -> Self:
        refuse(
            [
                Fault(key, f"expected [from, to] with from < to, got {list(interval)}")
                for key, interval in (("x", self.x), ("y", self.y))
                if interval[0] >= interval[1]
            ]
        )
        return self


class WalkTerrainSpec(SpecModel):
    """The ground: flat without end, or level regions."""

    friction: Number = quantity("", "friction coefficient", default=1.0, gt=0, le=5)
    regions: tuple[LevelRegionSpec, ...] = Field(
        default=(), description="level regions, such as steps; flat ground if left out"
    )

    @model_validator(mode="after")
    def _apart(self) -> Self:
        faults = []
        for i, region in enumerate(self.regions):
            for other in self.regions[:i]:
                if region.name == other.name:
                    message = f"names must differ, {region.name!r} is there already"
                    faults.append(Fault(f"regions.{i}.name", message))
                if _overlap(region.x, other.x) and _overlap(region.y, other.y):
                    faults.append(Fault(f"regions.{i}", f"overlaps region {other.name!r}"))
        refuse(faults)
        return self


def _overlap(one: Interval, other: Interval) -> bool:
    return one[0] < other[1] - 1e-9 and other[0] < one[1] - 1e-9


class WalkStartSpec(SpecModel):
    """Where the body starts; the toes stand under it."""

    position: Pair = quantity("m", "x and y of the centre of mass", default=(0.0, 0.0))
    height: Number = quantity(
        "m", "of the centre of mass above the ground under it", default=0.2, gt=0, lt=2
    )
    velocity: Vector = quantity("m/s", "world frame", default=(0.0, 0.0, 0.0))
    rpy_deg: Vector = quantity("deg", "roll, pitch, yaw", default=(0.0, 0.0, 0.0))
    angular_velocity: Vector = quantity("rad/s", "world frame", default=(0.0, 0.0, 0.0))
    toes: dict[str, Pair] = quantity(
        "m", "x and y of toes, world frame, by leg; the middle of its workspace if left out", {}
    )

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        refuse(_angle_faults("rpy_deg", self.rpy_deg))
        return self


class WalkReferenceSpec(SpecModel):
    """What is tracked."""

    velocity: Vector = quantity("m/s", "world frame", default=(1.8, 0.0, 0.0))
    rpy_deg: Vector = quantity("deg", "roll, pitch, yaw", default=(0.0, 0.0, 0.0))
    height: Number = quantity(
        "m", "of the centre of mass above the ground", default=0.2, gt=0, lt=2
    )

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        refuse(_angle_faults("rpy_deg", self.rpy_deg))
        return self


def _angle_faults(key: str, rpy: Vector) -> list[Fault]:
    return [
        Fault(key, f"expected {name} between -90 and 90 degrees, got {angle:g}")
        for name, angle in zip(("roll", "pitch", "yaw"), rpy, strict=True)
        if not (-90 < angle < 90 or (name == "yaw" and abs(angle) == 90))
    ]


class WalkTaskSpec(SpecModel):
    """Horizon, start and reference."""

    knots: Count = quantity("", "intervals of the horizon", default=9, ge=2, le=40)
    step: Number = quantity("s", "length of an interval", default=0.08, gt=0.005, le=0.5)
    integrator: Literal["euler", "mean"] = Field(
        default="euler",
        description="`euler`: forward Euler between knots, as published; `mean`: moment arms "
        "averaged over each interval in which the body moves on, which agrees with continuous time",
    )
    start: WalkStartSpec = WalkStartSpec()
    """Where the body starts."""
    reference: WalkReferenceSpec = WalkReferenceSpec()
    """What is tracked."""
    least_contacts: Count = quantity(
        "", "legs that stand in every interval at least", default=0, ge=0, le=4
    )
    whole_stance: bool = Field(
        default=False,
        description="standing toes stay in their boxes until the interval's end, while the body "
        "moves on; as published only at knots",
    )
    lift: Number = quantity(
        "m", "height of swinging toes above the ground", default=0.04, gt=0, le=0.12
    )


class WalkWeightsSpec(SpecModel):
    """Weights of the objective, eq. (8.30); the published ones if left out."""

    velocity: Vector = quantity("s^2/m^2", "w_v on x, y, z", default=(100.0, 100.0, 10.0))
    angles: Vector = quantity("1/rad^2", "w_theta on roll, pitch, yaw", default=(10.0, 10.0, 10.0))
    height: Number = quantity("1/m^2", "w_h", default=10.0, ge=0)
    motion: Number = quantity("1/m^2", "on the body's steps", default=1.0, ge=0)
    force_difference: Number = quantity(
        "1/N^2",
        "on differences between the legs' forces; published without a unit of force, 1 for forces "
        "in units of half the weight",
        default=1e-3,
        ge=0,
    )

    @model_validator(mode="after")
    def _not_negative(self) -> Self:
        refuse(
            [
                Fault(key, f"expected three numbers >= 0, got {list(values)}")
                for key, values in (("velocity", self.velocity), ("angles", self.angles))
                if min(values) < 0
            ]
        )
        return self


class WalkTubeSpec(SpecModel):
    """Room about the attitude of the trajectory that `micp` starts from, and references near it."""

    angles_deg: Vector = quantity("deg", "of roll, pitch, yaw either way", default=(6, 12, 6))
    spin: Vector = quantity("rad/s", "of the angular velocity either way", default=(1.5, 3, 1.5))

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        faults = [
            Fault(key, f"expected three numbers between 0 and {most}, got {list(values)}")
            for key, values, most in (
                ("angles_deg", self.angles_deg, 45),
                ("spin", self.spin, 20),
            )
            if not (min(values) >= 0 and max(values) <= most)
        ]
        refuse(faults)
        return self


class WalkSolverSpec(SpecModel):
    """Method and limits."""

    method: Literal["search", "nlp", "micp", "online"] = Field(
        default="search",
        description="`search`: local search over gaits, each solved by SQP; `nlp`: contacts as "
        "complementarity, from the guess of a trot; `micp`: mixed-integer linear relaxation by "
        "HiGHS, with a bound; `online`: closed loop with integers from a library of solved walks",
    )
    time_limit: Number = quantity(
        "s",
        "of IPOPT or HiGHS; a cap of the search, which says if it ended it; of `online`: its "
        "library and its walk, what was walked by then is kept",
        150.0,
        gt=0,
    )
    qps: Count = quantity(
        "",
        "QPs that the search may solve (some 2 to 5 ms each): with the seed they decide what it "
        "finds, on any machine",
        default=600,
        ge=1,
    )
    gaits: Count | None = quantity(
        "",
        "gaits that the search may try beyond the named ones; as many as its QPs allow if left out",
        default=None,
        ge=1,
    )
    guess: Literal[
        "trot", "slow trot", "walking trot", "jump", "pace", "bound", "walk", "stand"
    ] = Field(default="trot", description="gait that `nlp` starts from")
    warm: Literal["nlp", "search"] = Field(
        default="nlp",
        description="what `micp` starts from: its cost bounds ranges, its gait is a partial start",
    )
    gap: Number = quantity(
        "",
        "relative gap at which `micp` stops: it looks for motions that are cheaper by that much",
        default=0.1,
        ge=0,
        lt=1,
    )
    arm_pieces: Count = quantity(
        "", "parts of each leg's arm in `micp`, with a binary each", default=2, ge=1, le=8
    )
    height_pieces: Count = quantity(
        "", "parts of the body's height in `micp`", default=2, ge=1, le=16
    )
    tube: WalkTubeSpec = WalkTubeSpec()
    """Where attitudes may be in the statement that `micp` bounds."""
    form: Literal["pinned", "published"] = Field(
        default="pinned",
        description="what `online` solves: `pinned`: the dynamics linearised about a neighbour, "
        "with DAQP; `published`: McCormick planes in the neighbour's regions, with OSQP, the first "
        "answer taken",
    )
    regions_beside: Number = quantity(
        "",
        "share of the regions on either side of the neighbour's that `published` allows too",
        default=0.0,
        ge=0,
        le=1,
    )


class WalkLibrarySpec(SpecModel):
    """Solved walks from random starts, which `online` takes its integers from."""

    size: Count = quantity("", "walks, each solved by `search`", default=12, ge=0, le=100_000)
    gaits: Count = quantity(
        "", "gaits tried for each beyond the named ones", default=5, ge=0, le=10_000
    )
    file: str | None = Field(
        default=None,
        min_length=1,
        description="library.h5 of an earlier run, or dataset.h5 of walks; the first `size` walks "
        "are used; solved anew if left out",
    )
    strategy: Literal["knn", "forest", "boosting", "network"] = Field(
        default="knn",
        description="how candidates are chosen: nearest neighbours, or a classifier of gaits "
        "trained on the sections at the start, with the nearest section of each likely gait",
    )


class PushSpec(SpecModel):
    """A sudden change of the body's velocity."""

    time: Number = quantity("s", "when", ge=0)
    velocity: Vector = quantity("m/s", "change, world frame")


class SensorNoiseSpec(SpecModel):
    """Standard deviations of what the controller is told at each tick."""

    velocity: Number = quantity("m/s", "of each component", default=0.0, ge=0)
    angles_deg: Number = quantity("deg", "of roll, pitch, yaw", default=0.0, ge=0)
    spin: Number = quantity("rad/s", "of the angular velocity", default=0.0, ge=0)
    position: Number = quantity("m", "of height and toes", default=0.0, ge=0)


class AdmittanceSpec(SpecModel):
    """Admittance control of compliant legs, M u'' + D u' + K u = Kf (f - F), between knots.

    Gains of walking are assumed (published ones are of climbing, without units), and so is the leg.
    """

    mass: Number = quantity("kg", "M", default=1.0, gt=0)
    damping: Number = quantity("N s/m", "D", default=80.0, ge=0)
    stiffness: Number = quantity("N/m", "K; 0 tracks forces only", default=400.0, ge=0)
    force: Number = quantity("", "Kf; 0 tracks positions only", default=0.3, ge=0)
    leg_stiffness: Number = quantity("N/m", "of a leg", default=3000.0, gt=0, le=20_000)
    leg_damping: Number = quantity("N s/m", "of a leg", default=30.0, ge=0, le=200)


class SensorsSpec(SpecModel):
    """Standard deviations of what the estimator is given, and believed; the values are assumed."""

    gyro: Number = quantity("rad/s", "gyroscope, each sample", default=0.01, gt=0)
    accel: Number = quantity("m/s^2", "accelerometer, each sample", default=0.1, gt=0)
    toe: Number = quantity("m", "toes in the body, by encoders", default=0.005, gt=0)


class LostContactSpec(SpecModel):
    """A leg that makes no contact any more."""

    time: Number = quantity("s", "from when on", ge=0)
    leg: str = Field(min_length=1, description="name of the leg")


class WalkLoopSpec(SpecModel):
    """The closed loop of `online`: nonlinear rigid body in continuous time."""

    duration: Number = quantity("s", "simulated time", default=3.0, gt=0, le=600)
    pushes: tuple[PushSpec, ...] = Field(default=(), description="disturbances")
    noise: SensorNoiseSpec = SensorNoiseSpec()
    """Errors of the measurements."""
    delay: Number = quantity(
        "s", "from a measurement until its command is in force", default=0.0, ge=0, le=0.5
    )
    compensate: bool = Field(
        default=True, description="plan from the state that is predicted for after the delay"
    )
    legs: Literal["ideal", "admittance"] = Field(
        default="ideal",
        description="`ideal`: planned forces exactly; `admittance`: compliant legs, controlled",
    )
    admittance: AdmittanceSpec = AdmittanceSpec()
    """Gains of `legs: admittance`."""
    estimation: Literal["none", "ekf"] = Field(
        default="none",
        description="`none`: the true state and `noise`; `ekf`: a contact-aided Kalman filter on "
        "IMU, encoders and contacts",
    )
    sensors: SensorsSpec = SensorsSpec()
    """Sensors of `estimation: ekf`."""
    lost_contacts: tuple[LostContactSpec, ...] = Field(default=(), description="failures")
    candidates: Count = quantity("", "neighbours tried at most in a tick", default=8, ge=1, le=1000)
    enough: Count = quantity(
        "", "answers that hold, of which the cheapest is taken", default=2, ge=1, le=1000
    )
    iterations: Count = quantity("", "QPs for each gait at most", default=2, ge=1, le=100)
    effort: Count = quantity(
        "",
        "steps of the QP solver in a tick at most, named gaits included; assembling a QP counts "
        "as 60",
        default=1400,
        ge=0,
        le=10_000_000,
    )

    @model_validator(mode="after")
    def _in_time(self) -> Self:
        late = [(f"pushes.{k}.time", push.time) for k, push in enumerate(self.pushes)]
        late += [
            (f"lost_contacts.{k}.time", lost.time) for k, lost in enumerate(self.lost_contacts)
        ]
        refuse(
            [
                Fault(key, f"expected a time before the end at {self.duration:g} s, got {time:g}")
                for key, time in late
                if time >= self.duration
            ]
        )
        return self

    @model_validator(mode="after")
    def _one_error_model(self) -> Self:
        noise = self.noise
        noisy = noise.velocity + noise.angles_deg + noise.spin + noise.position > 0
        if self.estimation == "ekf" and noisy:
            message = "is of what is told without an estimator; with `ekf` see `sensors`"
            refuse([Fault("noise", message)])
        return self


class MpcSpec(SpecModel):
    """Footsteps, gait, body motion and contact forces of a walking quadruped, chosen together."""

    kind: Literal["mpc"] = Field(description="always `mpc`")
    title: str = Field(default="", description="one line for reports")
    robot: str = Field(
        default="scaler",
        min_length=1,
        description="built-in rigid body (`scaler`) or path of a rigid-body YAML file",
    )
    terrain: WalkTerrainSpec = WalkTerrainSpec()
    """The ground."""
    task: WalkTaskSpec = WalkTaskSpec()
    """Horizon, start and reference."""
    weights: WalkWeightsSpec = WalkWeightsSpec()
    """The objective."""
    solver: WalkSolverSpec = WalkSolverSpec()
    """Method and limits."""
    library: WalkLibrarySpec = WalkLibrarySpec()
    """What `online` takes its integers from."""
    loop: WalkLoopSpec = WalkLoopSpec()
    """The closed loop of `online`."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _online_can(self) -> Self:
        faults = []
        if self.solver.method == "online":
            if self.terrain.regions:
                faults.append(Fault("terrain.regions", "`online` walks on flat ground only"))
            if self.task.integrator != "mean":
                message = "`online` runs in continuous time, which needs `integrator: mean`"
                faults.append(Fault("task.integrator", message))
        elif self.task.whole_stance and self.solver.method in ("nlp", "micp"):
            message = f"`{self.solver.method}` states the workspace at knots only; use `search`"
            faults.append(Fault("task.whole_stance", message))
        if self.solver.method == "micp" and self.task.integrator != "euler":
            message = "`micp` states forward Euler steps only: `integrator: euler`"
            faults.append(Fault("task.integrator", message))
        refuse(faults)
        return self


class RigidBodySpec(SpecModel):
    """A quadruped as a single rigid body (`robots/bodies/scaler.yaml`)."""

    kind: Literal["rigid-body"] = Field(description="always `rigid-body`")
    name: str = Field(min_length=1, description="name used in reports")
    mass: Number = quantity("kg", "total mass", gt=0)
    inertia: tuple[Vector, Vector, Vector] = quantity(
        "kg m^2", "about the centre of mass, body frame (x forward, y left, z up)"
    )
    gravity: Number = quantity("m/s^2", "along -z", default=9.81, gt=0)
    force_limit: Number = quantity("N", "largest component of a contact force", gt=0)
    toe_half: Vector = quantity("m", "half extents of the toes' workspace boxes")
    legs: dict[str, Vector] = quantity(
        "m", "middle of each leg's box, body frame: left front, right front, left hind, right hind"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        faults = []
        if len(self.legs) != 4:
            faults.append(Fault("legs", f"expected four legs, got {len(self.legs)}"))
        if min(self.toe_half) <= 0:
            message = f"expected three numbers > 0, got {list(self.toe_half)}"
            faults.append(Fault("toe_half", message))
        rows = self.inertia
        if any(abs(rows[i][j] - rows[j][i]) > 1e-9 for i in range(3) for j in range(i)):
            faults.append(Fault("inertia", "expected a symmetric matrix"))
        elif not _positive_definite(rows):
            faults.append(Fault("inertia", "expected a positive definite matrix"))
        refuse(faults)
        return self


def _positive_definite(m: tuple[Vector, Vector, Vector]) -> bool:
    two = m[0][0] * m[1][1] - m[0][1] * m[1][0]
    three = (
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    )
    return m[0][0] > 0 and two > 0 and three > 0
