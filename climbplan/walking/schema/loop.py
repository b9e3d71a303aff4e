"""The closed loop of `online`: disturbances, sensors, compliant legs, and limits of a tick.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Count, Fault, Number, SpecModel, Vector, quantity, refuse


class PushSpec(SpecModel):
    """A sudden change of the body's velocity."""

    time: Number = quantity("s", "when", ge=0)
    velocity: Vector = quantity("m/s", "change, world frame")


class SensorNoiseSpec(SpecModel):
    """Standard deviations of what the controller is told at each tick."""

    velocity: Number = quantity("m/s", "of each component", default=0.0, ge=0)
    angles_deg: Number = quantity("deg", "of roll, pitch, yaw", default=0.0, ge=0)
    angular_velocity: Number = quantity("rad/s", "of the angular velocity", default=0.0, ge=0)
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
    foot_velocity_std: Number = quantity(
        "m/s", "velocities of toes in the body, by joint velocities; 0: not measured", 0.1, ge=0
    )


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
    compensate_delay: bool = Field(
        default=True, description="plan from the state that is predicted for after the delay"
    )
    replan_trigger: Literal["push", "knots"] = Field(
        default="push",
        description="`push`: also when one is felt, as an acceleration that no planned force "
        "explains, for the rest of the interval; `knots`: at knots only, every 80 ms",
    )
    dropout_probability: Number = quantity(
        "", "share of measurements at knots that do not arrive: predicted from the one before",
        0.0, ge=0, le=0.9,
    )  # fmt: skip
    lift_unreachable_stance_feet: bool = Field(
        default=True,
        description="a standing toe 19 mm out of its box lifts and the others brace, instead of "
        "standing on until the knot's end, which verification does not pass",
    )
    leg_model: Literal["ideal", "admittance"] = Field(
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
    max_candidates: Count = quantity(
        "", "neighbours tried at most in a tick", default=8, ge=1, le=1000
    )
    min_feasible_candidates: Count = quantity(
        "", "answers that hold, of which the cheapest is taken", default=2, ge=1, le=1000
    )
    iterations: Count = quantity("", "QPs for each gait at most", default=2, ge=1, le=100)
    height_weight: Number | None = quantity(
        "1/m^2",
        "w_h of ticks in place of `weights.height`: a body that is let fall while it brakes has to "
        "be caught by legs that bear little more than its weight; none: as of `weights`",
        default=None,
        ge=0,
    )
    max_qp_iterations: Count = quantity(
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
            (f"lost_contacts.{k}.time", loss.time) for k, loss in enumerate(self.lost_contacts)
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
        noisy = noise.velocity + noise.angles_deg + noise.angular_velocity + noise.position > 0
        if self.estimation == "ekf" and noisy:
            message = "is of what is told without an estimator; with `ekf` see `sensors`"
            refuse([Fault("noise", message)])
        return self
