"""A closed-loop run of a spec: build the library, simulate the loop, and record the plan."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from importlib import metadata
from pathlib import Path

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.progress import Progress
from climbplan.store.dataset_file import FORMAT, read_dataset_file
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.walking.dynamics.cost import compute_cost_terms
from climbplan.walking.offline.warm_up import warm_up
from climbplan.walking.online.admittance import AdmittanceGains
from climbplan.walking.online.candidate_selection import (
    NAMED_GAIT,
    PLAN_CONTINUES,
    PREVIOUS_PLAN,
    SAFE_STANCE,
)
from climbplan.walking.online.closed_loop import (
    ContactLoss,
    LoopResult,
    LoopScenario,
    Push,
    freeze_garbage,
    has_recovered,
    simulate_loop,
)
from climbplan.walking.online.controller import OnlineController, OnlineSettings, build_horizon_task
from climbplan.walking.online.dataset_rows import KIND, read_frame_task, read_walk
from climbplan.walking.online.estimation import SensorQuality
from climbplan.walking.online.footholds import flatten_task
from climbplan.walking.online.library import (
    SectionLibrary,
    build_library,
    cut_sections,
    is_symmetric,
    merge_libraries,
    mirror_library,
    read_library,
)
from climbplan.walking.online.section_ranking import train_section_ranking
from climbplan.walking.online.state_feedback import StateNoise
from climbplan.walking.plan.axes import orient_plan
from climbplan.walking.plan.foot_centres import raise_plan
from climbplan.walking.plan.walk_plan import LoopRecord, WalkPlan
from climbplan.walking.problem.problem import build_sampled_task, build_task
from climbplan.walking.problem.scanning import fit_walk_scan, load_walk_surface
from climbplan.walking.problem.spec_axes import convert_to_walking_axes
from climbplan.walking.published.program import TOLERANCE
from climbplan.walking.schema.loading import LoadedMpc
from climbplan.walking.schema.loop import WalkLoopSpec
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.solver import WalkLibrarySpec
from climbplan.walking.task.task import VELOCITY, WalkTask


def is_dataset(path: Path) -> bool:
    """Return whether a file is a dataset.

    Raises:
        PlanFileError: the file is not HDF5.
    """
    with open_store(path) as file:
        reader = Reader(path, file)
        return reader.has_attribute("", "format") and reader.text("", "format") == FORMAT


def read_dataset_library(path: Path, key: str, key_of: Callable[[WalkTask], str]) -> SectionLibrary:
    """Read the sections of all walks of a dataset, numbered by walk, and their mirror images.

    Args:
        path: the dataset.
        key: of the task that the sections are for.
        key_of: computes the key of a task.

    Raises:
        PlanFileError: a damaged file.
        UsageError: walks of another task, or no walks.
    """
    data = read_dataset_file(path)
    if data.frame.kind != KIND:
        raise UsageError(f"{path}: a dataset of {data.frame.kind!r}, not of walks")
    task = read_frame_task(data.frame, path)
    if key_of(task) != key:
        raise UsageError(f"{path}: made for another robot, reference or weights")
    rows = np.flatnonzero(data.feasible)
    if not len(rows):
        raise UsageError(f"{path}: no row has a walk")
    sections = [cut_sections(*read_walk(task, data, int(row)), k) for k, row in enumerate(rows)]
    library = merge_libraries(sections)
    return (
        merge_libraries([library, mirror_library(task, library)]) if is_symmetric(task) else library
    )


MAX_WARNINGS = 20  # of ticks in a plan file


@dataclass(frozen=True)
class OnlineRun:
    """The record of a closed-loop run, and the library to be stored with it."""

    plan: WalkPlan
    library: SectionLibrary
    key: str  # of the library's task


def run_online(loaded: LoadedMpc, report: Progress | None = None) -> OnlineRun:
    """Load or build the library, then walk. Compilation precedes the time limit.

    Args:
        loaded: the spec and its robot.
        report: receives stages and fractions; None: nothing is reported.

    Raises:
        SpecError: values that contradict each other.
        LimitReached: the time limit came before the library was complete.
        UsageError, PlanFileError: a library that cannot be used.
    """
    report = report or _ignore_progress
    loaded = fit_walk_scan(loaded)
    spec, scan = loaded.spec, load_walk_surface(loaded)
    task = build_task(spec, loaded.robot, loaded.source, scan=scan)
    key = compute_library_key(task)
    report("compile", 0.0)
    warm_up(task)
    deadline = time.monotonic() + spec.solver.time_limit
    begin = time.perf_counter()
    report("library", 0.0)
    library = load_library(
        task, spec.library, loaded.directory, spec.seed, key, report, deadline=deadline
    )
    ready = time.perf_counter()
    ranking = train_section_ranking(spec.library.strategy, library, spec.seed)
    controller = OnlineController(task, library, build_settings(spec), ranking)
    with freeze_garbage():
        loop = simulate_loop(
            controller,
            task,
            spec.loop.duration,
            build_scenario(convert_to_walking_axes(spec).loop, task),
            seed=spec.seed,
            report=lambda fraction: report("walk", fraction),
            deadline=deadline,
        )
    walked = time.perf_counter()
    plan = raise_plan(_build_plan(loaded, task, library, loop, ready - begin, walked - ready))
    plan = orient_plan(plan, spec.forward)
    return OnlineRun(plan, library, key)


def build_settings(spec: MpcSpec) -> OnlineSettings:
    """Return the tick settings of a spec."""
    return OnlineSettings(
        spec.loop.max_candidates,
        spec.loop.min_feasible_candidates,
        spec.loop.iterations,
        spec.loop.max_qp_iterations,
        form=spec.solver.formulation,
        neighbour_region_fraction=spec.solver.neighbour_region_fraction,
        height_weight=spec.loop.height_weight,
    )


def build_scenario(spec: WalkLoopSpec, task: WalkTask) -> LoopScenario:
    """Return the simulation scenario of a spec: disturbances, delay, sensors and legs."""
    noise, gains, sensors = spec.noise, spec.admittance, spec.sensors
    names = task.body.leg_names
    return LoopScenario(
        pushes=[Push(push.time, np.array(push.velocity, float)) for push in spec.pushes],
        noise=StateNoise(
            noise.velocity,
            float(np.deg2rad(noise.angles_deg)),
            noise.angular_velocity,
            noise.position,
        ),
        delay_samples=round(spec.delay / task.sample),
        compensate_delay=spec.compensate_delay,
        admittance=AdmittanceGains(**gains.model_dump())
        if spec.leg_model == "admittance"
        else None,
        estimation=SensorQuality(**sensors.model_dump()) if spec.estimation == "ekf" else None,
        replan_at_push=spec.replan_trigger == "push",
        dropout_probability=spec.dropout_probability,
        lift_unreachable_feet=spec.lift_unreachable_stance_feet,
        contact_losses=[
            ContactLoss(lost.time, names.index(lost.leg)) for lost in spec.lost_contacts
        ],
    )


def load_library(
    task: WalkTask,
    spec: WalkLibrarySpec,
    directory: Path,
    seed: int,
    key: str,
    report: Progress,
    *,
    deadline: float = math.inf,
) -> SectionLibrary:
    """Return the first `size` walks of a library file, or solve as many.

    Args:
        task: the walking task.
        spec: file, size and gaits of the library.
        directory: folder that file names are relative to.
        seed: of the random starts.
        key: of the task.
        report: receives stages and fractions.
        deadline: of `time.monotonic` [s].
    """
    if spec.file is None:
        flat_task = flatten_task(task)
        rest_task = replace(flat_task, start=replace(flat_task.start, state=_rest_state(flat_task)))
        return build_library(
            rest_task,
            spec.size,
            seed,
            spec.gaits,
            lambda fraction: report("library", fraction),
            deadline,
        )
    library = read_stored_library(directory / spec.file, key)
    if library.walks < spec.size:
        raise UsageError(
            f"{spec.file}: {library.walks} walks with sections, library.size asks for {spec.size}"
        )
    return library.select_walks(spec.size)


def read_stored_library(path: Path, key: str) -> SectionLibrary:
    """Read all walks of a library.h5 or dataset.h5 for the task with a key."""
    if is_dataset(path):
        return read_dataset_library(path, key, compute_library_key)
    return read_library(path, key)


_PLACEMENT = ("slope", "corners", "edge", "standoff", "region_friction", "allowed", "scan")


def compute_library_key(task: WalkTask) -> str:
    """Return a key, equal for tasks that differ only in start and placement of the terrain."""
    digest = hashlib.sha256()
    horizon = build_horizon_task(flatten_task(task))
    for holder in (horizon.body, horizon.ground, horizon.reference, horizon.weights):
        for field in fields(holder):
            value = getattr(holder, field.name)
            if holder is horizon.ground and field.name in _PLACEMENT:
                continue  # constant, because libraries are built on flat ground
            digest.update(repr(value.tolist() if isinstance(value, np.ndarray) else value).encode())
    scalars = (
        task.dt,
        task.integrator,
        task.swing_clearance,
        task.min_contacts,
        task.workspace_over_stance,
    )
    digest.update(repr(scalars).encode())
    return digest.hexdigest()


def _rest_state(task: WalkTask) -> Array:
    """Return the state (12,) at rest at the reference height."""
    state = np.zeros(len(task.start.state))
    state[2] = task.reference.height[0]
    return state


def _build_plan(
    loaded: LoadedMpc,
    task: WalkTask,
    library: SectionLibrary,
    loop: LoopResult,
    building: float,
    walking: float,
) -> WalkPlan:
    """Return the plan file's content for a closed-loop run."""
    spec, trajectory = loaded.spec, loop.trajectory
    num_samples = len(trajectory.state)
    sampled = build_sampled_task(task, num_samples - 1)
    tick = np.searchsorted(loop.tick_samples, np.arange(num_samples), side="right") - 1
    commands = loop.commands
    terms = compute_cost_terms(sampled, trajectory.state, trajectory.force)
    tick_warnings = [
        f"{sample * sampled.dt:.2f} s: {command.warning}"
        for sample, command in zip(loop.tick_samples, commands, strict=True)
        if command.warning
    ]
    return WalkPlan(
        name=loaded.name,
        title=spec.title,
        method="online",
        status="limit" if loop.cut_short else "feasible",
        task=sampled,
        trajectory=trajectory,
        objective=sum(terms.values()),
        terms=terms,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        robot_text=loaded.robot_text,
        robot_urdf=loaded.robot_urdf,
        seed=spec.seed,
        timings={"library": building, "walk": walking, "method": walking},
        solvers=_name_solvers(spec.solver.formulation),
        sizes={
            "knots": loop.num_ticks,
            "walks": library.walks,
            "sections": len(library),
            "gaits tried": sum(command.num_candidates for command in commands),
        },
        loop=LoopRecord(
            push=loop.push_velocity,
            tick_time=np.array([c.tick_time for c in commands])[tick],
            solve_time=np.array([c.solve_time for c in commands])[tick],
            candidates_tried=_as_integers([c.num_candidates for c in commands])[tick],
            winner=_as_integers([c.source for c in commands])[tick],
            warnings=tuple(tick_warnings[:MAX_WARNINGS]),
            samples=task.samples,
        ),
        warnings=tuple(_collect_warnings(loaded, task, loop, sampled, tick_warnings)),
        summary=_summarise(loaded, task, library, loop),
    )


def _collect_warnings(
    loaded: LoadedMpc, task: WalkTask, loop: LoopResult, sampled: WalkTask, tick_warnings: list[str]
) -> list[str]:
    """Return the warnings of a plan: how the walk ended, and the ticks with a warning."""
    warnings = []
    if not has_recovered(loop, task):
        warnings = ["the mean velocity at the end is not the reference's"]
    if loop.fall_time is not None:
        warnings = [f"the robot fell after {loop.fall_time:.2f} s"]
    if loop.cut_short:
        spec = loaded.spec
        seconds = (len(loop.trajectory.state) - 1) * sampled.dt
        walked = f"{seconds:.2f} of {spec.loop.duration:g} s"
        limit = f"solver.time_limit of {spec.solver.time_limit:g} s"
        warnings = [f"{limit} ended the walk after {walked}"]
    if tick_warnings:
        ticks = f"{len(tick_warnings)} of {len(loop.commands)} ticks"
        warnings.append(f"{ticks} with a warning, first {tick_warnings[0]}")
    return warnings


def _summarise(
    loaded: LoadedMpc, task: WalkTask, library: SectionLibrary, loop: LoopResult
) -> tuple[str, ...]:
    """Return the lines that describe the run on the terminal."""
    times = 1e3 * np.array([command.tick_time for command in loop.commands])
    median, slowest = np.percentile(times, [50, 99])
    source = np.array([command.source for command in loop.commands])
    counts = {"plan before": source == PREVIOUS_PLAN, "neighbours": source >= 0}
    counts |= {"named gaits": source == NAMED_GAIT, "safe stance": source == SAFE_STANCE}
    if (source == PLAN_CONTINUES).any():
        counts["plan kept"] = source == PLAN_CONTINUES
    sources = ", ".join(f"{name} {count.sum()}" for name, count in counts.items())
    robot = f"{task.body.name} {task.body.mass:g} kg, {loop.num_ticks} ticks"
    speed = loop.trajectory.state[:, VELOCITY]
    speeds = f"forward speed from {speed[:, 0].min():.2f} to {speed[:, 0].max():.2f} m/s"
    reach = f"largest overreach {1e3 * loop.reach_violation:.0f} mm"
    ending = "recovered" if has_recovered(loop, task) else "not recovered"
    if loop.cut_short:
        ending = "cut short"
    return (
        f"{loaded.name}   {robot}, library of {library.walks} walks, {len(library)} sections",
        f"online   tick median {median:.2f} ms, 99 % {slowest:.2f} ms   {sources}",
        f"walk   {ending}   {speeds}, {reach}",
    )


def _name_solvers(form: str) -> dict[str, str]:
    """Return the solvers of a form with their versions."""
    solvers = {"method": "online"}
    if form == "published":
        return solvers | {"osqp": f"{metadata.version('osqp')}, tolerance {TOLERANCE:g}"}
    return solvers | {"daqp": metadata.version("daqp")}


def _as_integers(values: list[int]) -> IntArray:
    """Return integers as an array."""
    return np.array(values, np.int64)


def _ignore_progress(stage: str, fraction: float) -> None:
    """Ignore a progress report."""
    pass
