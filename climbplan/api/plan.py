"""Plans of all kinds as Python objects: arrays of the plan file, checks, reports, replays."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import io
import os
import shutil
import tempfile
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import h5py

from climbplan.api.kinds import PlanKind, identify_kind
from climbplan.api.plan_group import Folder, Group
from climbplan.api.plan_path import PLAN_FILE, find_plan
from climbplan.deprecation import RenamedAttribute, renamed_parameters
from climbplan.errors import MissingSolver, UsageError, VerificationFailed
from climbplan.store.hdf5_reading import open_store

if TYPE_CHECKING:
    import pandas

    from climbplan.api.loading import SpecSource
    from climbplan.climb.simulation.executive.executive import ClimbExecutive
    from climbplan.climb.simulation.executive.settings import ExecutiveSettings
    from climbplan.simulation.report_files import SimulationRecord
    from climbplan.verification.verification import Verification


class Plan(Group):
    """A plan of any kind.

    Arrays, groups and root attributes of its file are attributes: `plan.rounds.com` (M+1, 3) of a
    climb, `plan.force` (T, 4, 3) of a walk, `plan.status`, `plan.objective`. Units and frames are
    those of the file: `plan.units("rounds/com")` returns them, the page on plan files lists them.
    """

    def __init__(self, path: Path, folder: Folder | None = None) -> None:
        self._kind: PlanKind = identify_kind(path)
        super().__init__(path, "", folder)
        self.summary: tuple[str, ...] = self._texts("summary")  # lines of the run that made it
        self.warnings: tuple[str, ...] = self._texts("warnings")  # to be looked at before use
        self.notes: tuple[str, ...] = self._texts("notes")  # changes on the way, nothing to do

    @property
    def kind(self) -> str:
        """The kind of the spec that it was planned from, such as "climb" or "mpc"."""
        return str(self._attributes["format"]).removeprefix("climbplan/")

    def units(self, name: str) -> tuple[str, str]:
        """Return units and frame of an array by its path: `("m", "world")`."""
        with open_store(self._path) as file:
            if name not in file or not isinstance(file[name], h5py.Dataset):
                raise UsageError(f"no array {name!r} in this plan")
            attributes = file[name].attrs
            return str(attributes.get("units", "")), str(attributes.get("frame", ""))

    @renamed_parameters(set="overrides")
    def verify(
        self, spec: SpecSource | None = None, overrides: Mapping[str, Any] | None = None
    ) -> Verification:
        """Check every constraint again, from the file alone.

        Args:
            spec: your own spec in place of the one stored in the plan, in any form that
                `climbplan.load_spec` takes; None means the stored one.
            overrides: values by dotted key that replace those of `spec`.

        Returns:
            The checks, with `.passed`, `.badge` and `.table()`.

        Raises:
            UsageError: the spec is of another kind, or `overrides` come without a spec.
        """
        if spec is None:
            if overrides:
                raise UsageError("`overrides` change the spec given as `spec`, and none is given")
            return self._kind.verify(self._path)
        from climbplan.api.holding import match_spec_to_plan
        from climbplan.api.loading import load_spec

        return self._kind.verify(
            self._path, match_spec_to_plan(self._path, load_spec(spec, overrides), "a spec")
        )

    def _texts(self, name: str) -> tuple[str, ...]:
        """Return the lines of a text dataset; () for kinds of plans that have none."""
        return tuple(self._array(name)) if self._members.get(name) is False else ()

    def save(self, path: str | Path, force: bool = False) -> Path:
        """Copy the plan file, completely or not at all.

        Args:
            path: file to write; in a directory, or a path without suffix, it is `plan.h5`.
            force: replace an existing file.

        Returns:
            The path of the copy.

        Raises:
            UsageError: the file exists and `force` is not set, or it cannot be written.
        """
        target = Path(path)
        if target.is_dir() or target.suffix == "":
            target = target / PLAN_FILE
        if target.exists() and not force:
            raise UsageError(f"{target}: already exists; force=True replaces it")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            number, temporary = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
            os.close(number)
            try:
                shutil.copyfile(self._path, temporary)
                os.replace(temporary, target)
            finally:
                Path(temporary).unlink(missing_ok=True)
        except OSError as error:
            raise UsageError(f"{target}: cannot be written: {error.strerror or error}") from error
        return target

    def write_report(self, folder: str | Path) -> Path:
        """Write report.html, report.json and figures/ into a folder and return the page's path.

        Files of an older report in the folder are replaced. The page is self-contained.
        """
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        self._kind.write_report(self._path, target)
        return target / "report.html"

    def show(self, height: int = 480) -> None:
        """Show a replay of the plan: in a notebook below the cell, elsewhere in the browser.

        Args:
            height: height of the picture [pixels].

        Raises:
            UsageError: there is nothing to look at, as in a dataset.
        """
        from climbplan.api.progress_display import find_notebook_display
        from climbplan.reports.notebook import build_replay_frame, build_replay_page

        scene = self._kind.read_scene(self._path)
        display = find_notebook_display()
        if display is not None:
            frame = build_replay_frame(scene, height)
            display({"text/html": frame, "text/plain": f"replay of {scene.title}"}, raw=True)
            return
        page = Path(tempfile.mkdtemp(prefix="climbplan.")) / "replay.html"
        page.write_text(build_replay_page(scene, height), encoding="utf-8")
        webbrowser.open(page.as_uri())

    def view(self, port: int = 8080, browser: bool = True) -> None:
        """Serve the interactive 3-D view of `climbplan view` on this machine until Ctrl-C.

        Args:
            port: port of the page; 0 takes a free one, and one that is taken the next free one.
            browser: whether a browser is opened.

        Raises:
            MissingSolver: viser is not installed.
        """
        if importlib.util.find_spec("viser") is None:
            raise MissingSolver("`view` needs viser: pip install 'climbplan[view]'")
        from climbplan.reports.viewer.server import Viewer

        with Viewer(self._kind.read_scene(self._path), "127.0.0.1", port) as viewer:
            print(f"{viewer.address} until Ctrl-C")
            if browser:
                webbrowser.open(viewer.address)
            with contextlib.suppress(KeyboardInterrupt):
                viewer.run()

    def film(self, path: str | Path) -> Path:
        """Write a film (.gif, .webp or .mp4) and a still (.png) beside it; return the film's path.

        Raises:
            UsageError: the name ends otherwise, or nothing moves.
            MissingSolver: MuJoCo or an encoder is missing.
        """
        from climbplan.exports.film import write_film

        verification = self.verify()
        badge = verification.badge + (", fragile" if verification.fragile else "")
        write_film(self._kind.read_scene(self._path), Path(path), badge)
        return Path(path)

    def export(
        self,
        path: str | Path,
        format: str = "csv",
        *,
        rate: float | None = None,
        gains: str | None = None,
        pace: float | Literal["fastest"] = 1.0,
    ) -> Path:
        """Write the motion for a robot or another simulator, as `climbplan export` does.

        Args:
            path: file to write, or for formats of several files a directory that does not exist.
            format: "csv", "npz", "mcap", "ros2", "jtc", "usd", or "motion", an NPZ file with
                contacts for pipelines that track motions.
            rate: sample rate [Hz]; None keeps the plan's own samples, of "motion" 50 Hz.
            gains: P gain of the controller [N m/rad], a YAML file of gains, or "rigid"; None keeps
                the robot's joint stiffness.
            pace: of "motion": factor on the planned speed of a climb, or the fastest that inverse
                dynamics allow.

        Raises:
            UsageError: the format is not known, the path exists, or the plan has no motion.
            VerificationFailed: the plan fails its verification.
        """
        from climbplan.exports.formats import FORMATS, ControllerOptions, adapt_motion
        from climbplan.exports.formats import apply_trajectory_controller_defaults as apply_defaults

        target = Path(path)
        names = [*FORMATS, "motion"]
        if format not in names:
            raise UsageError(f"no format {format!r}: expected one of {', '.join(names)}")
        if target.exists():
            raise UsageError(f"{target}: already exists")
        if objection := self.verify().objection:
            raise VerificationFailed(f"{self._path} {objection}")
        if format == "motion":
            from climbplan.motions.motion_file import write_motion_file

            if gains is not None or target.suffix != ".npz":
                raise UsageError(f"{target}: expected a file that ends with .npz, without gains")
            tracked = self._kind.read_tracked_motion(self._path, rate, pace)
            write_motion_file(dataclasses.replace(tracked, is_verified=True), target)
            return target
        if pace != 1.0:
            raise UsageError(f"pace={pace!r}: expected with format 'motion'")
        motion = self._kind.read_motion(self._path)
        options = ControllerOptions(rate, gains)
        if format == "jtc":
            options = apply_defaults(motion, options)
        if FORMATS[format].directory:
            target.mkdir(parents=True)
        FORMATS[format].write(adapt_motion(motion, options), target)
        return target

    def to_csv(self, path: str | Path | None = None) -> str:
        """Return motion, placements or rows as CSV text; write them to `path` if given."""
        stream = io.StringIO()
        self._kind.export_csv(self._path, stream)
        if path is not None:
            self._kind.export_csv(self._path, Path(path))
        return stream.getvalue()

    def to_frame(self) -> pandas.DataFrame:
        """Return the CSV table as a pandas DataFrame; raises MissingSolver without pandas."""
        try:
            import pandas
        except ImportError:
            raise MissingSolver("`to_frame` needs pandas: pip install 'climbplan[data]'") from None
        return pandas.read_csv(io.StringIO(self.to_csv()))

    def simulate(
        self,
        folder: str | Path | None = None,
        *,
        runs: int = 0,
        seed: int = 0,
        jobs: int = 1,
        pictures: bool = False,
        **conditions: Any,
    ) -> Simulation:
        """Replay the plan in MuJoCo.

        Args:
            folder: directory for report.json, report.html, simulation.csv and figures; None writes
                nothing.
            runs: further replays in randomised worlds.
            seed: of the randomised worlds.
            jobs: worker processes of the randomised worlds.
            pictures: draw the figures.
            conditions: fields of `climbplan.simulation.conditions.Conditions`, such as
                `friction=0.8` (factor) or `payload=1.0` (kg).

        Returns:
            The outcome, with `.passed`, `.fall_time`, `.slips` and `.data`.

        Raises:
            UsageError: a condition is not known.
            MissingSolver: MuJoCo is not installed.
            PlanFileError: plans of this kind have no simulated model.
        """
        from climbplan.api.simulating import find_simulator

        _, run = find_simulator(self._path)(self._path)
        from climbplan.simulation.conditions import Conditions
        from climbplan.simulation.report_files import write_simulation
        from climbplan.simulation.request import SimulationRequest

        try:
            scenario = Conditions(**conditions)
        except TypeError:
            names = ", ".join(Conditions.__dataclass_fields__)
            unknown = ", ".join(sorted(set(conditions) - set(Conditions.__dataclass_fields__)))
            raise UsageError(f"no condition {unknown}: expected some of {names}") from None
        request = SimulationRequest(scenario, runs=runs, seed=seed, jobs=jobs, pictures=pictures)
        record, lines = run(request, lambda stage, fraction: None)
        if folder is not None:
            Path(folder).mkdir(parents=True, exist_ok=True)
            write_simulation(record, Path(folder))
        return Simulation(record, tuple(lines))

    def executive(self, settings: ExecutiveSettings | None = None) -> ClimbExecutive:
        """Return what executes this climb or transition on a robot in closed loop.

        Args:
            settings: Thresholds of measurements; None for the defaults.

        Returns:
            The executive at the start of the plan. It takes joint angles and motor torques and
            returns joint commands.

        Raises:
            UsageError: the plan is no climb or transition, is timed by its dynamics, or its robot
                has grippers, flat feet or five-bar legs.
        """
        if self.kind not in ("climb", "transition"):
            raise UsageError(
                f"{self._path} is of kind {self.kind}: expected a climb or transition; walks have "
                "a controller of their own"
            )
        from climbplan.climb.plan.file import read_climb
        from climbplan.climb.simulation.executive.executive import ClimbExecutive

        return ClimbExecutive(read_climb(self._path), settings=settings)

    report = RenamedAttribute("write_report")

    @property
    def _description(self) -> str:
        return f"this plan of kind {self.kind}"

    def __dir__(self) -> list[str]:
        """Return methods and properties, then groups and arrays; no internals."""
        return list(dict.fromkeys(name for name in super().__dir__() if not name.startswith("_")))

    def _repr_html_(self) -> str:
        from climbplan.reports.notebook import (
            build_badge,
            build_dataset_tables,
            build_figures,
            build_replay_frame,
        )

        verification = self.verify()
        sections = [build_badge(verification.level, verification.badge, verification.advice)]
        sections.append(build_figures([*self.summary, *verification.fragile]))
        if self._kind.is_in_space and verification.unsound is None:
            sections.append(build_replay_frame(self._kind.read_scene(self._path), 300))
        if self.kind == "dataset" and verification.unsound is None:
            from climbplan.store.dataset_file import read_dataset_file

            sections.append(build_dataset_tables(read_dataset_file(self._path)))
        return "".join(sections)

    def __repr__(self) -> str:
        root = self._attributes
        badge = root.get("badge") or ("verified" if root.get("verified") else "not verified")
        return f"<Plan of kind {self.kind}: {root.get('status')}, {badge}>"


@dataclass(frozen=True)
class Simulation:
    """The outcome of a replay in MuJoCo."""

    record: SimulationRecord
    lines: tuple[str, ...]  # on random runs

    @property
    def passed(self) -> bool:
        """Whether the robot did not fall, and slipped no more than its kind lets pass."""
        return not self.record.end.failure(None)

    @property
    def slips(self) -> int:
        """Number of toes that slid."""
        return self.record.end.slips

    @property
    def fall_time(self) -> float | None:
        """Time of the fall [s]; None if the robot did not fall."""
        return self.record.end.fall_time

    @property
    def data(self) -> Mapping[str, Any]:
        """All figures, as in report.json."""
        return self.record.report

    stands = RenamedAttribute("passed")
    report = RenamedAttribute("data")

    def __repr__(self) -> str:
        return f"<Simulation: {self.record.headline}>"


def load_plan(path: str | Path) -> Plan:
    """Open a plan file, or the one in an output directory; no code in it is executed.

    Raises PlanFileError for a file that is missing, damaged or not a plan.
    """
    return Plan(find_plan(Path(path)))
