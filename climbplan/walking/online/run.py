"""A closed-loop run of a spec: its library, the loop, and the plan that records it."""

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
from climbplan.store.hdf5_reading import Reader, opened_store
from climbplan.walking.dynamics.cost import cost_terms
from climbplan.walking.offline.warm_up import warm_up
from climbplan.walking.online.admittance import AdmittanceGains
from climbplan.walking.online.closed_loop import (
    Loop,
    LoopWorld,
    Lost,
    Push,
    collected_before,
    recovered,
    run_loop,
)
from climbplan.walking.online.dataset_rows import KIND, task_of_frame, walk_of
from climbplan.walking.online.estimation import SensorQuality
from climbplan.walking.online.footholds import on_flat_ground
from climbplan.walking.online.library import (
    Library,
    build_library,
    joined,
    mirrored,
    read_library,
    sections_of,
    symmetric,
)
from climbplan.walking.online.perception import Noise
from climbplan.walking.online.strategies import trained
from climbplan.walking.online.tick import OnlineController, OnlineSettings, horizon_of
from climbplan.walking.plan.foot_centres import raised
from climbplan.walking.plan.walk_plan import LoopRecord, WalkPlan
from climbplan.walking.problem.problem import build_task, sampled_task
from climbplan.walking.published.program import TOLERANCE
from climbplan.walking.schema.loading import LoadedMpc
from climbplan.walking.schema.loop import WalkLoopSpec
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.solver import WalkLibrarySpec
from climbplan.walking.task.task import VELOCITY, WalkTask


def is_dataset(path: Path) -> bool:
    """Whether a file says that it is a dataset; raises PlanFileError for one that is not HDF5."""
    with opened_store(path) as file:
        reader = Reader(path, file)
        return reader.has_attribute("", "format") and reader.text("", "format") == FORMAT


def library_of_dataset(path: Path, key: str, key_of: Callable[[WalkTask], str]) -> Library:
    """Sections of all walks of a dataset, numbered by walk, and their mirror images.

    key: of the task that they are to serve; key_of: makes it of a task. Raises PlanFileError for a
    damaged file, UsageError for walks of another task or no walks.
    """
    data = read_dataset_file(path)
    if data.frame.kind != KIND:
        raise UsageError(f"{path}: a dataset of {data.frame.kind!r}, not of walks")
    task = task_of_frame(data.frame, path)
    if key_of(task) != key:
        raise UsageError(f"{path}: made for another robot, reference or weights")
    rows = np.flatnonzero(data.feasible)
    if not len(rows):
        raise UsageError(f"{path}: no row has a walk")
    parts = [sections_of(*walk_of(task, data, int(row)), k) for k, row in enumerate(rows)]
    whole = joined(parts)
    return joined([whole, mirrored(task, whole)]) if symmetric(task) else whole


MOST_WARNINGS = 20  # of ticks, told one by one


@dataclass(frozen=True)
class OnlineRun:
    """The record of a loop, and the library to be kept beside it."""

    plan: WalkPlan
    library: Library
    key: str  # of the task that the library was made for


def run_online(loaded: LoadedMpc, report: Progress | None = None) -> OnlineRun:
    """Build or read the library, then walk. What is compiled is so before the time limit counts.

    Raises:
        SpecError: values that do not go together.
        LimitReached: the time limit came before the library was there.
        UsageError, PlanFileError: a library that cannot be used.
    """
    report = report or _silent
    spec = loaded.spec
    task = build_task(spec, loaded.robot, loaded.source)
    key = library_key(task)
    report("compile", 0.0)
    warm_up(task)
    deadline = time.monotonic() + spec.solver.time_limit
    begin = time.perf_counter()
    report("library", 0.0)
    library = library_of(task, spec.library, loaded.directory, spec.seed, key, report, deadline)
    ready = time.perf_counter()
    ranking = trained(spec.library.strategy, library, spec.seed)
    controller = OnlineController(task, library, settings_of(spec), ranking)
    with collected_before():
        loop = run_loop(
            controller,
            task,
            spec.loop.duration,
            world_of(spec.loop, task),
            spec.seed,
            lambda share: report("walk", share),
            deadline,
        )
    walked = time.perf_counter()
    plan = raised(_plan(loaded, task, library, loop, ready - begin, walked - ready))
    return OnlineRun(plan, library, key)


def settings_of(spec: MpcSpec) -> OnlineSettings:
    """How a spec has ticks spend their time."""
    return OnlineSettings(
        spec.loop.candidates,
        spec.loop.enough,
        spec.loop.iterations,
        spec.loop.effort,
        form=spec.solver.form,
        beside=spec.solver.regions_beside,
        height_weight=spec.loop.height_weight,
    )


def world_of(spec: WalkLoopSpec, task: WalkTask) -> LoopWorld:
    """What a spec puts between controller and robot."""
    noise, gains, sensors = spec.noise, spec.admittance, spec.sensors
    names = task.body.leg_names
    return LoopWorld(
        pushes=[Push(push.time, np.array(push.velocity, float)) for push in spec.pushes],
        noise=Noise(
            noise.velocity, float(np.deg2rad(noise.angles_deg)), noise.spin, noise.position
        ),
        delay=round(spec.delay / task.sample),
        compensate=spec.compensate,
        admittance=AdmittanceGains(**gains.model_dump()) if spec.legs == "admittance" else None,
        estimation=SensorQuality(**sensors.model_dump()) if spec.estimation == "ekf" else None,
        at_push=spec.replan == "push",
        dropped=spec.dropped,
        letting_go=spec.letting_go,
        lost=[Lost(lost.time, names.index(lost.leg)) for lost in spec.lost_contacts],
    )


def library_of(
    task: WalkTask,
    spec: WalkLibrarySpec,
    directory: Path,
    seed: int,
    key: str,
    report: Progress,
    deadline: float = math.inf,
) -> Library:
    """The first `size` walks of a file, or as many solved anew; deadline of `time.monotonic`."""
    if spec.file is None:
        flat = on_flat_ground(task)
        rested = replace(flat, start=replace(flat.start, state=_at_rest(flat)))
        return build_library(
            rested,
            spec.size,
            seed,
            spec.gaits,
            lambda share: report("library", share),
            deadline,
        )
    library = stored_library(directory / spec.file, key)
    if library.walks < spec.size:
        raise UsageError(
            f"{spec.file}: {library.walks} walks with sections, library.size asks for {spec.size}"
        )
    return library.first(spec.size)


def stored_library(path: Path, key: str) -> Library:
    """All walks of a library.h5 or dataset.h5 that were made for the task with this key."""
    if is_dataset(path):
        return library_of_dataset(path, key, library_key)
    return read_library(path, key)


def library_key(task: WalkTask) -> str:
    """Equal for tasks that differ in their start and in where the ground is only."""
    digest = hashlib.sha256()
    ahead = horizon_of(on_flat_ground(task))
    for holder in (ahead.body, ahead.ground, ahead.reference, ahead.weights):
        for field in fields(holder):
            value = getattr(holder, field.name)
            if holder is ahead.ground and field.name in ("slope", "corners", "edge", "standoff"):
                continue  # of flat ground, where all libraries are made
            digest.update(repr(value.tolist() if isinstance(value, np.ndarray) else value).encode())
    rest = (task.step, task.integrator, task.lift, task.least_contacts, task.whole_stance)
    digest.update(repr(rest).encode())
    return digest.hexdigest()


def _at_rest(task: WalkTask) -> Array:
    state = np.zeros(len(task.start.state))
    state[2] = task.reference.height[0]
    return state


def _plan(
    loaded: LoadedMpc,
    task: WalkTask,
    library: Library,
    loop: Loop,
    building: float,
    walking: float,
) -> WalkPlan:
    spec, found = loaded.spec, loop.trajectory
    samples = len(found.state)
    whole = sampled_task(task, samples - 1)
    tick = np.searchsorted(loop.at, np.arange(samples), side="right") - 1
    commands = loop.commands
    terms = cost_terms(whole, found.state, found.force)
    warned = [
        f"{sample * whole.step:.2f} s: {command.warning}"
        for sample, command in zip(loop.at, commands, strict=True)
        if command.warning
    ]
    back = recovered(loop, task)
    told = [] if back else ["the mean velocity at the end is not the reference's"]
    if loop.fell is not None:
        told = [f"the robot fell after {loop.fell:.2f} s"]
    if loop.cut_short:
        walked = f"{(samples - 1) * whole.step:.2f} of {spec.loop.duration:g} s"
        told = [f"solver.time_limit of {spec.solver.time_limit:g} s ended the walk after {walked}"]
    if warned:
        told.append(f"{len(warned)} of {len(commands)} ticks with a warning, first {warned[0]}")
    times = 1e3 * np.array([command.tick_time for command in commands])
    median, most = np.percentile(times, [50, 99])
    won = np.array([command.winner for command in commands])
    speed = found.state[:, VELOCITY]
    robot = f"{task.body.name} {task.body.mass:g} kg, {loop.ticks} ticks"
    chosen = {"plan before": won == -1, "neighbours": won >= 0}
    chosen |= {"named gaits": won == -2, "safe stance": won == -3}
    if (won == -4).any():
        chosen["plan kept"] = won == -4
    shares = ", ".join(f"{name} {count.sum()}" for name, count in chosen.items())
    range_ = f"forward speed from {speed[:, 0].min():.2f} to {speed[:, 0].max():.2f} m/s"
    reach = f"largest overreach {1e3 * loop.overreach:.0f} mm"
    ended = "recovered" if back else "not recovered"
    if loop.cut_short:
        ended = "cut short"
    summary = (
        f"{loaded.name}   {robot}, library of {library.walks} walks, {len(library)} sections",
        f"online   tick median {median:.2f} ms, 99 % {most:.2f} ms   {shares}",
        f"walk   {ended}   {range_}, {reach}",
    )
    return WalkPlan(
        name=loaded.name,
        title=spec.title,
        method="online",
        status="limit" if loop.cut_short else "feasible",
        task=whole,
        trajectory=found,
        objective=sum(terms.values()),
        terms=terms,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        robot_text=loaded.robot_text,
        robot_urdf=loaded.robot_urdf,
        seed=spec.seed,
        timings={"library": building, "walk": walking, "method": walking},
        solvers=_solvers(spec.solver.form),
        sizes={
            "knots": loop.ticks,
            "walks": library.walks,
            "sections": len(library),
            "gaits tried": sum(command.tried for command in commands),
        },
        loop=LoopRecord(
            push=loop.pushed,
            tick_time=np.array([c.tick_time for c in commands])[tick],
            solve_time=np.array([c.solve_time for c in commands])[tick],
            candidates_tried=_whole([c.tried for c in commands])[tick],
            winner=_whole([c.winner for c in commands])[tick],
            warnings=tuple(warned[:MOST_WARNINGS]),
            samples=task.samples,
        ),
        warnings=tuple(told),
        summary=summary,
    )


def _solvers(form: str) -> dict[str, str]:
    used = {"method": "online"}
    if form == "published":
        return used | {"osqp": f"{metadata.version('osqp')}, tolerance {TOLERANCE:g}"}
    return used | {"daqp": metadata.version("daqp")}


def _whole(values: list[int]) -> IntArray:
    return np.array(values, np.int64)


def _silent(stage: str, fraction: float) -> None:
    pass
