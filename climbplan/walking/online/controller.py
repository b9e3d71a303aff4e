"""Hybrid model-predictive control: one tick of the online controller.

Library sections, found by ranking, give the integers (contacts and regions) of each candidate. A
fixed-integer QP is solved for each, linearised about the section's own motion. If the nonlinear
rollout does not validate its solution, a second QP about that solution follows (`gait_solver.py`).
A tick has a fixed budget of QP iterations, which bounds its time.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.kernels.body import NUM_SUBSTEPS, integrate_rk4
from climbplan.walking.offline.fixed_contact_qp import WalkIterate
from climbplan.walking.offline.footing import build_footing
from climbplan.walking.offline.gaits import repeat_gait
from climbplan.walking.online.candidate_selection import (
    NAMED_GAIT,
    PLAN_CONTINUES,
    PREVIOUS_PLAN,
    SAFE_STANCE,
    CandidateSelection,
    Command,
)
from climbplan.walking.online.features import compute_features
from climbplan.walking.online.footholds import (
    build_terrain_gait,
    compute_reference_clearance,
    continue_regions,
    follow_terrain,
    project_to_footholds,
)
from climbplan.walking.online.gait_adaptation import (
    build_flat_gait,
    extract_iterate,
    find_reachable_legs,
    restrict_gait,
    shift_plan,
)
from climbplan.walking.online.gait_solver import GaitSolution, GaitSolver, IterationBudget
from climbplan.walking.online.library import SECTION, SectionLibrary
from climbplan.walking.online.safe_stance import plan_safe_stance
from climbplan.walking.online.section_ranking import NearestNeighbours, Ranking
from climbplan.walking.online.stance import limit_landing
from climbplan.walking.online.tick_input import TickInput, detect_fault
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    VELOCITY,
    Gait,
    Start,
    WalkTask,
    WalkTrajectory,
)

_NAMED_GAITS = (("trot", 0), ("trot", 1), ("stand", 0), ("walking trot", 0), ("walking trot", 2))
_MAX_ELASTIC_QPS = 4
_NUM_ELASTIC_RETRIES = 2  # candidates
_NAMED_GAIT_FRACTION = 0.6  # of a tick's iterations that is reserved for named gaits
_CONTACT_TIMEOUT_TICKS = 6  # for which a leg without detected contact must not stand
_STEADY_TICKS = 3  # between two full searches
_PREDICTION_VELOCITY_TOLERANCE = 0.15  # [m/s]
_PREDICTION_ANGLE_TOLERANCE = 0.06  # [rad]
_REFERENCE_TOLERANCE = 0.1  # [m/s]
_STEADY_TOLERANCE = 0.03  # [m/s] of a plan whose alternatives are not solved
_NUM_PREPARED_PROGRAMS = 200
# In tolerances, where no plan is feasible: following such a plan is better than standing still
_MAX_ACCEPTED_VIOLATION = 60.0
Form = Literal["pinned", "published"]


@dataclass(frozen=True)
class OnlineSettings:
    """Limits of the search of a tick."""

    max_candidates: int = 8  # gaits from the library
    min_feasible: int = 2  # feasible candidates that end the search; the cheapest is taken
    max_qps_per_gait: int = 2
    max_qp_iterations: int = 1400  # DAQP iterations in a tick; a QP's assembly counts as some
    margin: float = 8e-3  # [m] to the sides of workspace boxes, of toes yet to be placed
    form: Form = "pinned"  # fixed-integer QPs, or the published program (`published/`)
    height_weight: float | None = None  # [1/m^2] in place of the task's
    # Neighbouring regions that the published form may choose
    neighbour_region_fraction: float = 0.0


@dataclass(frozen=True)
class _PredictedState:
    """The state after a plan's first interval; without a plan, the task's start."""

    task: WalkTask
    state: Array
    walk: WalkTrajectory | None = None

    @property
    def start(self) -> Start:
        """The predicted start: standing toes stay, swinging toes are at their landings."""
        walk, task = self.walk, self.task
        if walk is None:
            return task.start
        touchdown = limit_landing(task, self.state, walk.toes[1])
        toes = np.where(walk.gait.contact[0][:, None], walk.toes[0], touchdown)
        return Start(self.state, project_to_footholds(task.ground, toes))


@dataclass(frozen=True)
class _GaitCandidate:
    """A gait with its origin and a first point of linearisation."""

    source: int
    gait: Gait
    # First point of linearisation, possibly built on demand; None for uniform motion
    iterate: WalkIterate | Callable[[], WalkIterate] | None
    is_elastic: bool = False  # workspace rows may be violated at a penalty
    has_short_interval: bool = False  # first interval of `TickInput.short_interval`


class OnlineController:
    """A hybrid model-predictive controller with a horizon of `SECTION` intervals.

    At each tick it solves several candidates: the shifted previous plan, library sections, and
    named gaits.
    """

    def __init__(
        self,
        task: WalkTask,
        library: SectionLibrary,
        settings: OnlineSettings,
        ranking: Ranking | None = None,
    ) -> None:
        """Prepare the controller and compile its programs.

        Args:
            task: body, terrain, references and weights; its horizon is shortened to that of a
                section.
            library: sections of solved walks.
            settings: limits of the search.
            ranking: order of the library's sections for a measurement; nearest neighbours if None.
        """
        horizon_task, self._reference_clearance = (
            build_horizon_task(task),
            compute_reference_clearance(task),
        )
        if settings.height_weight is not None:
            horizon_task = replace(
                horizon_task, weights=replace(horizon_task.weights, height=settings.height_weight)
            )
        self.task = horizon_task
        self.library, self.settings = library, settings
        self._ranking: Ranking = ranking if ranking is not None else NearestNeighbours(library)
        self._solver = GaitSolver(self.task, settings.margin, settings.neighbour_region_fraction)
        self._previous_plan: WalkTrajectory | None = None
        # Used at the next tick where its measurement is faulty
        self._prediction = _PredictedState(self.task, task.start.state)
        self._ticks_since_search = 0
        # (L,) ticks for which each leg must not stand
        self._distrusted_ticks = np.zeros(task.body.leg_count, np.int64)
        self._flat_gaits: dict[int, Gait] = {}  # by section, on ground of one region
        self._warm_up()

    def tick(self, measurement: TickInput) -> Command:
        """Plan one tick of the model-predictive controller.

        Args:
            measurement: state, toes and contacts at the instant when the plan begins.

        Returns:
            The cheapest feasible plan. Where none is feasible, with a warning: between knots the
            previous plan, else the plan of least violation, else the safe stance.
        """
        selection = CandidateSelection(IterationBudget(self.settings.max_qp_iterations))
        self._distrusted_ticks = np.maximum(self._distrusted_ticks - 1, 0)
        self._distrusted_ticks[list(measurement.undetected_contacts)] = _CONTACT_TIMEOUT_TICKS
        if fault := detect_fault(measurement, self.task.body):
            return self._command_safe_stance(selection, fault, self._prediction.start)
        start = Start(measurement.state, measurement.toes)
        task = replace(self.task, start=start, first=measurement.time_to_knot)
        task = follow_terrain(task, self._reference_clearance)
        self._search_candidates(task, measurement, selection)
        return self._select_command(task, measurement, selection)

    def _search_candidates(
        self, task: WalkTask, measurement: TickInput, selection: CandidateSelection
    ) -> None:
        """Solve candidates until enough are feasible or the iteration budget is exhausted."""
        trusted = self._distrusted_ticks == 0
        if measurement.airborne is not None:
            trusted = trusted & ~measurement.airborne
        available = find_reachable_legs(task) & trusted
        is_steady = self._check_steady(task)
        min_feasible = 1 if is_steady else self.settings.min_feasible
        solved: set[tuple[bytes, bool]] = set()
        short_variant: tuple[WalkTask, BoolArray] | None = None  # built where it is needed
        for candidate in self._generate_candidates(task, measurement, selection, available):
            if selection.num_tried and selection.budget.is_exhausted:
                break
            variant, standing = task, available
            if candidate.has_short_interval:
                if short_variant is None:
                    short_task = replace(task, first=measurement.short_interval)
                    short_variant = short_task, find_reachable_legs(short_task) & trusted
                variant, standing = short_variant
            gait = restrict_gait(variant, candidate.gait, standing)
            # The published form decides on regions, too: the same gait may be another program.
            may_repeat = candidate.is_elastic or self._is_published_form
            if gait is None or (
                (gait.key, candidate.has_short_interval) in solved and not may_repeat
            ):
                continue
            solved.add((gait.key, candidate.has_short_interval))
            iterate = candidate.iterate() if callable(candidate.iterate) else candidate.iterate
            if gait is not candidate.gait:  # without a leg that cannot stand now
                gait = build_terrain_gait(
                    variant, gait.contact, None if iterate is None else iterate.state
                )
            selection.num_tried += 1
            clock_start = time.perf_counter()
            solution = self._solve_candidate(variant, gait, candidate, iterate, selection)
            selection.solve_clock += time.perf_counter() - clock_start
            if solution is not None:
                selection.record(solution, candidate.source, variant.first)
                if (
                    is_steady
                    and solution.is_feasible
                    and not _tracks_reference(task, solution.trajectory)
                ):
                    min_feasible, self._ticks_since_search = self.settings.min_feasible, 0
                if self._is_published_form:
                    break  # as published: the first solution is final
            if selection.num_feasible >= min_feasible or (
                selection.num_feasible and candidate.is_elastic
            ):
                break

    def _check_steady(self, task: WalkTask) -> bool:
        """Return whether the robot walks as predicted, so that one feasible candidate suffices.

        Every `_STEADY_TICKS` ticks the search is full nevertheless.
        """
        self._ticks_since_search += 1
        velocity_error = np.abs(task.start.state[VELOCITY] - task.reference.velocity[0]).max()
        is_steady = float(velocity_error) < _REFERENCE_TOLERANCE
        is_steady = is_steady and _matches_prediction(self._prediction.state, task.start)
        is_steady = is_steady and self._ticks_since_search < _STEADY_TICKS
        is_steady = is_steady and not self._is_published_form
        if not is_steady:
            self._ticks_since_search = 0
        return is_steady

    def _select_command(
        self, task: WalkTask, measurement: TickInput, selection: CandidateSelection
    ) -> Command:
        """Return the command of the best plan, or of a fallback with the reason as a warning."""
        warnings = [] if len(self.library) else ["the library is empty"]
        if self._distrusted_ticks.any():
            legs = [
                name
                for name, ticks in zip(task.body.leg_names, self._distrusted_ticks, strict=True)
                if ticks
            ]
            warnings.append(f"{', '.join(legs)} without contact")
        selected = selection.best
        if selected is None and measurement.time_to_knot and self._previous_plan is not None:
            warnings.append(f"none of {selection.num_tried} gaits holds, the plan before goes on")
            return selection.build_command(
                self._previous_plan, PLAN_CONTINUES, 0.0, ", and ".join(warnings)
            )
        if selected is None:
            warnings.append(f"none of {selection.num_tried} gaits holds")
            nearest = selection.nearest
            if nearest is None or (
                nearest.score >= _MAX_ACCEPTED_VIOLATION and not self._is_published_form
            ):
                reason = ", and ".join(warnings)
                return self._command_safe_stance(
                    selection, reason, task.start, measurement.short_interval
                )
            selected = nearest
            warnings[-1] += ", the nearest is taken"
        plan = selected.trajectory
        self._previous_plan = plan
        self._prediction = _PredictedState(task, plan.state[1], plan)
        return selection.build_command(
            plan, selected.source, selected.first_interval, ", and ".join(warnings)
        )

    def reset(self) -> None:
        """Forget the previous plan and all distrusted contacts."""
        self._previous_plan, self._ticks_since_search = None, 0
        self._prediction = _PredictedState(self.task, self.task.start.state)
        self._distrusted_ticks[:] = 0

    @property
    def _is_published_form(self) -> bool:
        """True if ticks solve the published program."""
        return self.settings.form == "published"

    def _warm_up(self) -> None:
        """Load compiled code and prepare the programs of the commonest gaits before time counts."""
        contact = self.library.contact.reshape(-1, (SECTION + 1) * self.library.contact.shape[2])
        gaits, count = np.unique(contact, axis=0, return_counts=True)
        # On terrain the regions of a gait differ from tick to tick.
        num_prepared = _NUM_PREPARED_PROGRAMS if self.task.ground.is_flat_everywhere else 0
        for row in gaits[np.argsort(-count)[:num_prepared]]:
            self._solver.prepare_program(self.task, build_flat_gait(row.reshape(SECTION + 1, -1)))
        stand = build_terrain_gait(
            self.task, repeat_gait("stand", self.task.body.leg_count, SECTION), None
        )
        find_reachable_legs(self.task)
        named = _GaitCandidate(NAMED_GAIT, stand, None, is_elastic=True)
        self._solve_candidate(
            self.task,
            stand,
            named,
            None,
            CandidateSelection(IterationBudget(self.settings.max_qp_iterations)),
        )

    def _generate_candidates(
        self,
        task: WalkTask,
        measurement: TickInput,
        selection: CandidateSelection,
        available: BoolArray,
    ) -> Iterator[_GaitCandidate]:
        """Yield the shifted previous plan, library sections, and named gaits as a fallback."""
        offered: list[_GaitCandidate] = []
        allow_short = measurement.short_interval > 0
        starts_short = allow_short and available.sum() < task.min_contacts
        if self._previous_plan is not None and not self._is_published_form:
            # Between knots the previous plan is still in its first interval
            is_mid_interval = measurement.time_to_knot > 0
            plan = self._previous_plan
            gait, iterate = (
                (plan.gait, extract_iterate(plan)) if is_mid_interval else shift_plan(plan)
            )
            gait = continue_regions(task, gait, iterate, plan, SECTION + is_mid_interval)
            offered.append(_GaitCandidate(PREVIOUS_PLAN, gait, iterate))
            yield replace(offered[-1], has_short_interval=True) if starts_short else offered[-1]
        reference = task.reference
        features = compute_features(measurement, float(reference.height[0]), reference.velocity[0])
        terrain_height = (
            0.0
            if task.ground.is_flat_everywhere
            else task.reference.height[0] - self._reference_clearance
        )
        base = np.array([*measurement.state[:2], terrain_height])
        may_use_library = len(self.library) and not self._is_published_form
        reserved_iterations = (
            0
            if not may_use_library
            else round(_NAMED_GAIT_FRACTION * self.settings.max_qp_iterations)
        )
        for index in self._ranking.rank(features, self.settings.max_candidates):
            if selection.budget.remaining <= reserved_iterations:
                break
            offered.append(self._build_section_candidate(task, int(index), base))
            yield replace(offered[-1], has_short_interval=True) if starts_short else offered[-1]
        if selection.num_feasible or self._is_published_form:
            return
        # Elastic retries: workspace rows are relaxed and the first interval may be shorter, so that
        # swinging legs land earlier. They are nearer to feasibility than named gaits.
        for candidate in offered[:_NUM_ELASTIC_RETRIES]:
            yield replace(candidate, is_elastic=True, has_short_interval=allow_short)
        for name, phase in _NAMED_GAITS:
            gait = build_terrain_gait(
                task, repeat_gait(name, task.body.leg_count, SECTION, phase), None
            )
            yield _GaitCandidate(
                NAMED_GAIT, gait, None, is_elastic=True, has_short_interval=allow_short
            )

    def _build_section_candidate(self, task: WalkTask, index: int, base: Array) -> _GaitCandidate:
        """Return a section of the library as a candidate, translated to the body's position."""
        state = None if task.ground.is_flat_everywhere else self._translate_states(index, base)
        gait = None if state is not None else self._flat_gaits.get(index)
        if gait is None:
            gait = build_terrain_gait(task, self.library.contact[index], state)
            if state is None:
                self._flat_gaits[index] = gait
        return _GaitCandidate(index, gait, partial(self._build_section_iterate, gait, index, base))

    def _build_section_iterate(self, gait: Gait, index: int, base: Array) -> WalkIterate:
        """Return a section's translated motion as a point of linearisation."""
        footing, library = build_footing(gait), self.library
        spots = library.toes[index][footing.first, footing.leg, :2] + base[:2]
        return WalkIterate(self._translate_states(index, base), library.force[index, :-1], spots)

    def _translate_states(self, index: int, base: Array) -> Array:
        """Return the states of a section, translated by base (3,)."""
        states = self.library.state[index].copy()
        states[:, POSITION] += base
        return states

    def _solve_candidate(
        self,
        task: WalkTask,
        gait: Gait,
        candidate: _GaitCandidate,
        initial_iterate: WalkIterate | None,
        selection: CandidateSelection,
    ) -> GaitSolution | None:
        """Solve a candidate's program; continue the SQP where this tick has begun it before."""
        program = self._solver.prepare_program(task, gait)
        if self._is_published_form and initial_iterate is not None:
            return self._solver.solve_published(task, program, initial_iterate, selection.budget)
        key = gait.key, candidate.source, candidate.has_short_interval
        progress = selection.progress.get(key)
        if progress is None:
            progress = selection.progress[key] = self._solver.initialise_progress(
                task, program, initial_iterate
            )
        iterations = _MAX_ELASTIC_QPS if candidate.is_elastic else self.settings.max_qps_per_gait
        return self._solver.solve(
            task, program, progress, iterations, selection.budget, candidate.is_elastic
        )

    def _command_safe_stance(
        self, selection: CandidateSelection, reason: str, start: Start, first_interval: float = 0.0
    ) -> Command:
        """Return the command of the fallback balance controller (safe stance).

        Args:
            selection: statistics of the tick.
            reason: why no plan is available, for the warning.
            start: measured start, or the predicted one after a faulty measurement.
            first_interval: length of the first interval where it is shorter than usual, else 0
                [s].
        """
        self._previous_plan = None
        task = replace(self.task, start=start, first=first_interval)
        walk, body = plan_safe_stance(task), task.body
        # If the next measurement is faulty the stance continues from its own prediction, because
        # braking must come to an end.
        next_state = integrate_rk4(
            body.parameters,
            float(task.steps[0]),
            NUM_SUBSTEPS,
            start.state,
            start.toes,
            walk.force[0],
        )
        if np.isfinite(next_state).all():
            self._prediction = _PredictedState(task, next_state, walk)
        return selection.build_command(walk, SAFE_STANCE, first_interval, f"safe stance: {reason}")


def _matches_prediction(expected: Array, start: Start) -> bool:
    """Return whether a measured start is close to the predicted state (12,)."""
    deviation = np.abs(start.state - expected)
    return bool(
        deviation[VELOCITY].max() < _PREDICTION_VELOCITY_TOLERANCE
        and deviation[ANGLES].max() < _PREDICTION_ANGLE_TOLERANCE
    )


def _tracks_reference(task: WalkTask, walk: WalkTrajectory) -> bool:
    """Return whether a plan keeps the reference velocity over the whole horizon.

    A section in which the robot comes to a stand does not: its last knots are slow.
    """
    deviation = np.abs(walk.state[1:, VELOCITY] - task.reference.velocity)[:, :2]
    return bool(deviation.max() < _STEADY_TOLERANCE)


def build_horizon_task(task: WalkTask) -> WalkTask:
    """Return the task over the knots of a section; its references must be constant."""
    reference = task.reference
    return replace(
        task,
        knots=SECTION,
        reference=replace(
            reference,
            velocity=np.tile(reference.velocity[-1], (SECTION, 1)),
            euler=np.tile(reference.euler[-1], (SECTION, 1)),
            height=np.full(SECTION, reference.height[-1]),
        ),
    )
