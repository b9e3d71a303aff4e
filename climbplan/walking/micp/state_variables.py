"""State variables of a walk, and McCormick envelopes of products in perspective form.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.attitude_box import AttitudeBox, bound_rotation
from climbplan.walking.micp.linear_model import LinearModel, LinExpr
from climbplan.walking.micp.variable_bounds import VariableBounds, propagate_body_ranges
from climbplan.walking.task.task import POSITION, VELOCITY, WalkTask

# A product whose envelope is narrower is replaced by a line with a remainder: nearly parallel rows
# are within the tolerance of the solver (1e-7), and let the simplex method cycle.
MIN_ENVELOPE_ERROR = 1e-5  # [SI units, forces in the force unit]
MIN_RANGE = 1e-7  # narrower ranges are rounding
_MIN_WIDTH = 1e-12  # [m] narrower ranges of an arm or a height are values


class StateVariables:
    """The states of all knots as variables, within an attitude box and below a cutoff."""

    def __init__(
        self,
        task: WalkTask,
        attitude_box: AttitudeBox,
        cutoff: float,
        arm_pieces: int,
        height_pieces: int,
        tangent_ratio: float,
        *,
        bounds: VariableBounds | None = None,
        constant_inertia: bool = False,
        num_rotation_knots: int | None = None,
    ) -> None:
        """Create the model with its states.

        Args:
            task: The task.
            attitude_box: Angles and angular velocities of all motions.
            cutoff: Limit on the cost of motions.
            arm_pieces: Pieces of each moment arm.
            height_pieces: Pieces of the height of the body.
            tangent_ratio: Ratio of the points of tangency of squares.
            bounds: Bounds of the variables; None: nothing but the limits of the task is known.
            constant_inertia: Take the inertia at the middle of the attitude box: fewer columns.
            num_rotation_knots: Knots with rows of rotation, and later ones are translations only;
                None: all knots.
        """
        self.constant_inertia = constant_inertia
        self.num_rotation_knots = (
            task.knots if num_rotation_knots is None else min(num_rotation_knots, task.knots)
        )
        self.task, self.attitude_box, self.cutoff = task, attitude_box, cutoff
        self.velocity_cost_columns: tuple[list[int], list[int]] = ([], [])
        self.fixed_velocity_cost = np.zeros(2)
        self.arm_pieces, self.height_pieces = arm_pieces, height_pieces
        self.tangent_ratio = tangent_ratio
        self.model = LinearModel(2.0 * cutoff)
        self.arms: dict[tuple[int, int], tuple[LinExpr, LinExpr]] = {}  # by knot and leg
        self.num_legs = task.body.leg_count
        self.force_unit = task.weight / self.num_legs
        self.max_force = task.body.force_limit / self.force_unit
        self.has_tight_bounds = bounds is not None
        if bounds is None:
            bounds = VariableBounds.create_open(task, cutoff, self.max_force)
        self.bounds = bounds
        # First column and constant of the cost of each interval
        self.stage_offsets: list[tuple[int, float]] = []
        self.contact_rows: dict[tuple[int, int], int] = {}  # by knot and leg
        self.rotations = [bound_rotation(task, attitude_box, n) for n in range(task.knots)]
        self.limit_body_ranges()
        self.add_states()

    def limit_body_ranges(self) -> None:
        """Compute ranges of the body's positions and velocities from cost, bounds and reach."""
        task, bounds = self.task, self.bounds
        ranges = propagate_body_ranges(task, self.cutoff)
        self.p_low, self.p_high = ranges.position
        self.v_low, self.v_high = ranges.velocity
        self.p_low = np.maximum(self.p_low, bounds.state_low[:, POSITION])
        p_high = np.minimum(self.p_high, bounds.state_high[:, POSITION])
        self.p_high = np.maximum(p_high, self.p_low)
        self.v_low = np.maximum(self.v_low, bounds.state_low[:, VELOCITY])
        v_high = np.minimum(self.v_high, bounds.state_high[:, VELOCITY])
        self.v_high = np.maximum(v_high, self.v_low)
        for n in range(1, task.knots):
            low, high = self.bound_displacement(0, n)
            self.p_low[n, :2] = np.maximum(self.p_low[n, :2], self.p_low[0, :2] + low)
            self.p_high[n, :2] = np.minimum(self.p_high[n, :2], self.p_high[0, :2] + high)
        level = task.ground.height
        for n in range(2, task.knots):
            min_height, max_height = self.find_body_height_range(n)
            highest = task.ground.max_swept_height + task.swing_clearance + max_height
            self.p_low[n, 2] = max(self.p_low[n, 2], level.min() + min_height)
            self.p_high[n, 2] = min(self.p_high[n, 2], highest)

    def add_states(self) -> None:
        """Add position, velocity, angles and angular velocity at knots 0 to N."""
        knots = self.task.knots
        add = self.model.add_variable
        p, v, angles, omega = [], [], [], []
        for n in range(knots + 1):
            p.append([add(a, b) for a, b in zip(self.p_low[n], self.p_high[n], strict=True)])
            v.append([add(a, b) for a, b in zip(self.v_low[n], self.v_high[n], strict=True)])
            middle, half = self.attitude_box.angles[n], self.attitude_box.angles_half[n]
            angles.append([add(m - h, m + h) for m, h in zip(middle, half, strict=True)])
            middle, half = self.attitude_box.omega[n], self.attitude_box.omega_half[n]
            is_last = n == knots  # the last angular velocity rotates nothing
            omega.append(
                [
                    add(-np.inf if is_last else m - h, np.inf if is_last else m + h)
                    for m, h in zip(middle, half, strict=True)
                ]
            )
        self.p, self.v, self.angles, self.omega = p, v, angles, omega

    def add_switched_variable(
        self, name: str, indicator: LinExpr, low: float, high: float
    ) -> LinExpr:
        """Add a variable within [low, high] if the indicator is 1, and zero if it is 0."""
        low, high = float(low), float(high)
        variable = self.model.add_variable(min(low, 0.0), max(high, 0.0))
        self.model.add_nonnegative(name, variable - indicator * low)
        self.model.add_nonnegative(name, indicator * high - variable)
        return variable

    def add_switched_product(
        self,
        x: LinExpr,
        x_range: tuple[float, float],
        y: LinExpr,
        y_range: tuple[float, float],
        indicator: LinExpr,
    ) -> LinExpr:
        """Return the product x y by its McCormick envelope, eq. (8.26) in perspective form.

        Args:
            x: The first factor, zero if the indicator is.
            x_range: Its range for an indicator of 1.
            y: The second factor, zero if the indicator is.
            y_range: Its range for an indicator of 1.
            indicator: A relaxed binary.
        """
        if x_range[1] - x_range[0] < _MIN_WIDTH:
            return y * x_range[0]
        (x_low, x_high), (y_low, y_high) = x_range, y_range
        if (error := 0.25 * (x_high - x_low) * (y_high - y_low)) <= MIN_ENVELOPE_ERROR:
            x_middle, y_middle = 0.5 * (x_low + x_high), 0.5 * (y_low + y_high)
            line = y * x_middle + x * y_middle - indicator * (x_middle * y_middle)
            return line + self.add_remainder(error)
        w = self.add_free_variable(max(abs(a * b) for a in x_range for b in y_range))
        self.add_mccormick_rows(w, x, x_range, y, y_range, indicator)
        return w

    def add_remainder(self, max_error: float) -> LinExpr:
        """Add the difference of a product and its line, at most `max_error` in size."""
        max_error = max(max_error, MIN_RANGE)
        return self.model.add_variable(-max_error, max_error)

    def add_free_variable(self, max_value: float) -> LinExpr:
        """Add a variable that its rows keep within `max_value`, and its own bounds never.

        A column without any bounds would keep HiGHS from proving infeasibility, whatever rounding
        leaves of its coefficient.
        """
        bound = 2.0 * max_value + 1.0
        return self.model.add_variable(-bound, bound)

    def add_mccormick_rows(
        self,
        w: LinExpr,
        x: LinExpr,
        x_range: tuple[float, float],
        y: LinExpr,
        y_range: tuple[float, float],
        indicator: LinExpr,
    ) -> None:
        """Add the four McCormick rows of w = x y, which vanish with the indicator."""
        (x_low, x_high), (y_low, y_high) = x_range, y_range
        add = self.model.add_nonnegative
        add("dynamics.angular_velocity", w - y * x_low - x * y_low + indicator * (x_low * y_low))
        add(
            "dynamics.angular_velocity", w - y * x_high - x * y_high + indicator * (x_high * y_high)
        )
        add("dynamics.angular_velocity", y * x_high + x * y_low - indicator * (x_high * y_low) - w)
        add("dynamics.angular_velocity", y * x_low + x * y_high - indicator * (x_low * y_high) - w)

    def add_friction_product(
        self,
        x_range: tuple[float, float],
        y: LinExpr,
        normal: LinExpr,
        x_normal: LinExpr,
        friction: float,
    ) -> LinExpr:
        """Return the product x y of an arm or height x with a tangential force y.

        As |y| <= mu f with a normal force f, each of (x - end) (mu f +- y) has the sign of x - end.

        Args:
            x_range: Range of x.
            y: The tangential force.
            normal: The normal force f.
            x_normal: The product x f.
            friction: The friction coefficient mu.
        """
        low, high = x_range
        if high - low < _MIN_WIDTH:
            return y * low
        model = self.model
        # |x y| <= |end| mu f, where f is at most the sum of the limits of all legs
        max_force = friction * self.num_legs * self.max_force
        w = self.add_free_variable(max(abs(low), abs(high)) * max_force)
        for side in (1.0, -1.0):
            model.add_nonnegative(
                "dynamics.angular_velocity",
                x_normal * friction + w * side - normal * (low * friction) - y * (low * side),
            )
            model.add_nonnegative(
                "dynamics.angular_velocity",
                normal * (high * friction) + y * (high * side) - x_normal * friction - w * side,
            )
        return w

    def find_arm_range(self, n: int, leg: int) -> tuple[Array, Array]:
        """Return least and largest moment arm (3,) of a toe in its box, about the heading axes."""
        rotation = self.rotations[n]
        return rotation.arm_low[leg], rotation.arm_high[leg]

    def find_body_height_range(self, n: int) -> tuple[float, float]:
        """Return the range of body heights at which all toes are in their boxes."""
        rotation = self.rotations[n]
        return float((-rotation.arm_high[:, 2]).max()), float((-rotation.arm_low[:, 2]).min())

    def rotate_to_world(self, n: int, vector: Sequence[LinExpr]) -> tuple[LinExpr, LinExpr]:
        """Rotate the x and y of a vector from the heading axes into the world frame."""
        (a, b), (c, d) = self.rotations[n].heading_axes[:2, :2].tolist()
        return vector[0] * a + vector[1] * b, vector[0] * c + vector[1] * d

    def bound_displacement(self, n: int, last: int) -> tuple[Array, Array]:
        """Bound the displacement (2,) of the body along x and y between two knots [m].

        All velocities that differ from the cheapest ones cost at most `velocity_cost` together. By
        the Cauchy-Schwarz inequality their sum is at most the root of their number times that cost.

        Args:
            n: The first knot.
            last: The last knot, n < last < N.

        Returns:
            Lower and upper bound.
        """
        task = self.task
        slow, fast = self.v_low[n:last, :2].sum(axis=0), self.v_high[n:last, :2].sum(axis=0)
        first = max(n, 1)  # the first velocity is given, and costs nothing
        tracking = task.weights.velocity[:2]
        weight = tracking + task.weights.motion * task.dt**2
        with np.errstate(divide="ignore", invalid="ignore"):
            fraction = np.where(weight > 0, tracking / weight, 0.0)
            deviation = np.sqrt((last - first) * self.bounds.velocity_cost / weight)
            deviation = np.where(weight > 0, deviation, np.inf)
        cheapest = fraction * task.reference.velocity[first - 1 : last - 1, :2].sum(axis=0)
        cheapest = cheapest + self.v_low[n:first, :2].sum(axis=0)
        low: Array = task.dt * np.maximum(slow, cheapest - deviation)
        high: Array = task.dt * np.minimum(fast, cheapest + deviation)
        return low, high

    def compute_interval(self, expression: LinExpr) -> tuple[float, float]:
        """Return least and largest value of an expression by interval arithmetic."""
        low = high = expression.constant
        for column, value in expression.terms.items():
            ends = sorted((value * self.model.lower[column], value * self.model.upper[column]))
            low, high = low + ends[0], high + ends[1]
        return low, high
