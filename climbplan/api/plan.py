"""Plans of one shape for every kind: what their file holds, and what can be done with it."""

from __future__ import annotations

import io
import json
import os
import shutil
import tempfile
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from climbplan.api.kinds import PlanKind, plan_kind
from climbplan.api.plan_path import PLAN_FILE, find_plan
from climbplan.errors import MissingSolver, UsageError
from climbplan.store.hdf5_layout import Kind, Layout
from climbplan.store.hdf5_reading import Reader, opened_store

if TYPE_CHECKING:
    import pandas

    from climbplan.api.loading import SpecSource
    from climbplan.simulation.report_files import Told
    from climbplan.verification.verification import Verification

_KINDS: dict[str, Kind] = {"f": "float", "i": "int", "u": "int", "b": "bool"}


class Folder:
    """A directory of its own for a plan that nobody has saved, there as long as it is looked at."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="climbplan."))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


class Group:
    """A group of a plan file: arrays, attributes and groups under their names there.

    Arrays are read when they are first asked for, and cannot be written to.
    """

    def __init__(self, path: Path, name: str, folder: Folder | None) -> None:
        self._path, self._name, self._folder = path, name, folder
        with opened_store(path) as file:
            group = Reader(path, file).group(name) if name else file
            self._members = {
                key: isinstance(group.get(key, getlink=True), h5py.HardLink)
                and isinstance(group[key], h5py.Group)
                for key in group
            }
            self._attributes = {key: _value(value) for key, value in group.attrs.items()}

    def __getattr__(self, name: str) -> Any:
        """An array, group or attribute of the file."""
        members = vars(self).get("_members", {})
        if name in members:
            value = self._group(name) if members[name] else self._array(name)
            vars(self)[name] = value
            return value
        if name in vars(self).get("_attributes", {}):
            return self._attributes[name]
        raise AttributeError(f"{self._shown} has no {name!r}; it has {', '.join(self._names())}")

    def __getitem__(self, name: str) -> Any:
        """The same by a path: `plan["instants/force"]`."""
        here: Any = self
        for part in name.split("/"):
            try:
                here = getattr(here, part)
            except AttributeError as error:
                raise KeyError(str(error)) from None
        return here

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._names()]

    def __repr__(self) -> str:
        return f"<{self._shown}: {', '.join(self._names())}>"

    @property
    def _shown(self) -> str:
        return f"group {self._name!r}"

    def _names(self) -> list[str]:
        return sorted([*self._members, *self._attributes])

    def _group(self, name: str) -> Group:
        full = f"{self._name}/{name}" if self._name else name
        return Group(self._path, full, self._folder)

    def _array(self, name: str) -> Any:
        full = f"{self._name}/{name}" if self._name else name
        with opened_store(self._path) as file:
            reader = Reader(self._path, file)
            held = file[full]
            shape = tuple(held.shape or ())
            if h5py.check_string_dtype(held.dtype) is not None:
                return reader.texts(full, Layout(shape, kind="text"))
            kind = _KINDS.get(held.dtype.kind)
            if kind is None:
                raise reader.refuse(f"{full} holds {held.dtype}, which no plan has")
            array = reader.array(full, Layout(shape, kind=kind, may_be_nan=True))
        array.flags.writeable = False
        return array


class Plan(Group):
    """A plan of any kind.

    Arrays, groups and root attributes of its file are attributes: `plan.rounds.com` (M+1, 3) of a
    climb, `plan.force` (T, 4, 3) of a walk, `plan.status`, `plan.objective`. Units and frames are
    those of the file, told by `plan.units("rounds/com")` and in the page on plan files.
    """

    def __init__(self, path: Path, folder: Folder | None = None) -> None:
        self._kind: PlanKind = plan_kind(path)
        super().__init__(path, "", folder)
        self.summary: tuple[str, ...] = self._texts("summary")  # lines of the run that made it
        self.warnings: tuple[str, ...] = self._texts("warnings")

    @property
    def kind(self) -> str:
        """Such as "climb", "mpc"."""
        return str(self._attributes["format"]).removeprefix("climbplan/")

    def units(self, name: str) -> tuple[str, str]:
        """Units and frame of an array by its path: `("m", "world")`."""
        with opened_store(self._path) as file:
            if name not in file or not isinstance(file[name], h5py.Dataset):
                raise UsageError(f"no array {name!r} in this plan")
            told = file[name].attrs
            return str(told.get("units", "")), str(told.get("frame", ""))

    def verify(
        self, spec: SpecSource | None = None, set: Mapping[str, Any] | None = None
    ) -> Verification:
        """Every constraint checked again from the file alone; `.passed`, `.badge`, `.table()`.

        spec, set: your own spec in place of the one that the plan carries, as `climbplan.load`
        takes them. Raises UsageError for a spec of another kind.
        """
        if spec is None:
            if set:
                raise UsageError("`set` changes the spec that `spec` names, and there is none")
            return self._kind.verify(self._path)
        from climbplan.api.holding import held_against
        from climbplan.api.loading import load

        return self._kind.verify(self._path, held_against(self._path, load(spec, set), "a spec"))

    def _texts(self, name: str) -> tuple[str, ...]:
        """Lines of text of the file; none of kinds that have none."""
        return tuple(self._array(name)) if self._members.get(name) is False else ()

    def save(self, path: str | Path, force: bool = False) -> Path:
        """Copy the plan file, whole or not at all; a folder gets `plan.h5`. Returns its path.

        Raises UsageError if a file is there and `force` is not set, or nothing can be written.
        """
        target = Path(path)
        if target.is_dir() or target.suffix == "":
            target = target / PLAN_FILE
        if target.exists() and not force:
            raise UsageError(f"{target}: already exists; force=True replaces it")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            number, aside = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
            os.close(number)
            try:
                shutil.copyfile(self._path, aside)
                os.replace(aside, target)
            finally:
                Path(aside).unlink(missing_ok=True)
        except OSError as error:
            raise UsageError(f"{target}: cannot be written: {error.strerror or error}") from error
        return target

    def report(self, folder: str | Path) -> Path:
        """Write report.html, report.json and figures/ into a folder; the path of the page.

        Files of an older report there are replaced. Needs nothing else to be looked at.
        """
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        self._kind.write_report(self._path, target)
        return target / "report.html"

    def to_csv(self, path: str | Path | None = None) -> str:
        """Motion (of climbs, walks, modules), placements or rows as CSV; written to `path`, too."""
        stream = io.StringIO()
        self._kind.export_csv(self._path, stream)
        if path is not None:
            self._kind.export_csv(self._path, Path(path))
        return stream.getvalue()

    def to_frame(self) -> pandas.DataFrame:
        """The same as a pandas table; raises MissingSolver where pandas is not installed."""
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
        """Replay the plan in MuJoCo: `.stands`, `.slips`, `.report`.

        folder: for report.json, report.html, simulation.csv and figures. runs: in random worlds.
        conditions: fields of `climbplan.simulation.conditions.Conditions`, such as
        `friction=0.8` (factor) or `payload=1.0` (kg). Raises UsageError for others,
        MissingSolver without MuJoCo, and PlanFileError for kinds without a simulated model.
        """
        from climbplan.api.simulating import simulator

        _, run = simulator(self._path)(self._path)
        from climbplan.simulation.asked import Asked
        from climbplan.simulation.conditions import Conditions
        from climbplan.simulation.report_files import write_simulation

        try:
            world = Conditions(**conditions)
        except TypeError:
            known = ", ".join(Conditions.__dataclass_fields__)
            strange = ", ".join(sorted(set(conditions) - set(Conditions.__dataclass_fields__)))
            raise UsageError(f"no condition {strange}: expected some of {known}") from None
        asked = Asked(world, runs=runs, seed=seed, jobs=jobs, pictures=pictures)
        told, lines = run(asked, lambda stage, fraction: None)
        if folder is not None:
            Path(folder).mkdir(parents=True, exist_ok=True)
            write_simulation(told, Path(folder))
        return Simulation(told, tuple(lines))

    @property
    def _shown(self) -> str:
        return f"this plan of kind {self.kind}"

    def __repr__(self) -> str:
        told = self._attributes
        badge = told.get("badge") or ("verified" if told.get("verified") else "not verified")
        return f"<Plan of kind {self.kind}: {told.get('status')}, {badge}>"


@dataclass(frozen=True)
class Simulation:
    """What a replay showed."""

    told: Told
    lines: tuple[str, ...]  # on random runs

    @property
    def stands(self) -> bool:
        """Whether the robot did not fall, and slipped no more than its kind lets pass."""
        return not self.told.end.failure(None)

    @property
    def slips(self) -> int:
        """Toes that slid."""
        return self.told.end.slips

    @property
    def fall_time(self) -> float | None:
        """[s], None of a robot that stands to the end."""
        return self.told.end.fall_time

    @property
    def report(self) -> Mapping[str, Any]:
        """All figures, as in report.json."""
        return self.told.report

    def __repr__(self) -> str:
        return f"<Simulation: {self.told.headline}>"


def read(path: str | Path) -> Plan:
    """A plan file, or the one in an output directory; nothing of it is run.

    Raises PlanFileError for a file that is missing, damaged or no plan.
    """
    return Plan(find_plan(Path(path)))


def _value(value: Any) -> Any:
    """An attribute as Python has it; what is stored as JSON text is read."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    if isinstance(value, str) and value[:1] in ("{", "["):
        try:
            return json.loads(value)
        except (ValueError, RecursionError):
            return value
    return value.item() if isinstance(value, np.generic) else value
