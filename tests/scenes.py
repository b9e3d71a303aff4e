"""One plan of every kind, made once in a test run and read by all workers."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from short_climb import SHORT_CLIMB

SPECS = Path(__file__).parents[1] / "specs"
SCENES: dict[str, tuple[str | Path, dict[str, Any]]] = {  # spec, and what is set in it
    "climb": (SHORT_CLIMB, {}),
    "transition": (SPECS / "transition_flat.yaml", {}),
    "walk": (SPECS / "mpc_forward.yaml", {"task.knots": 6}),
    "modules": (SPECS / "limms_throw.yaml", {}),
    "bookshelf": (SPECS / "bookshelf_scene.yaml", {}),
}


class PlannedScenes:
    """Folders with `plan.h5` and its report, by the names of `SCENES`; not to be changed."""

    def __init__(self, folders: SharedFolders) -> None:
        self.folders = folders

    def __getitem__(self, name: str) -> Path:
        """The plan file of a scene, planned now if nobody has asked for it before."""
        spec, changes = SCENES[name]
        return self.folders.make(name, lambda folder: _plan_into(folder, spec, changes)) / "plan.h5"


def _plan_into(folder: Path, spec: str | Path, changes: dict[str, Any]) -> None:
    import climbplan

    plan = climbplan.plan(climbplan.load_spec(spec, overrides=changes))
    plan.save(folder / "plan.h5")
    plan.write_report(folder)


class SharedFolders:
    """Folders that one worker of a test run fills and all of them read; not to be changed."""

    def __init__(self, place: Path) -> None:
        self.place = place
        place.mkdir(exist_ok=True)

    def make(self, name: str, fill: Callable[[Path], None]) -> Path:
        """Return a folder by name, filled now if nobody has asked for it before."""
        folder = self.place / name
        with (self.place / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # until it is closed, or its process ends
            if not folder.exists():
                part = folder.with_name(f"{name}.part")
                shutil.rmtree(part, ignore_errors=True)  # of a worker that was killed
                part.mkdir()
                fill(part)
                part.rename(folder)
        return folder


@pytest.fixture(scope="session")
def shared_folders(tmp_path_factory: pytest.TempPathFactory) -> SharedFolders:
    """Folders of this run; with several workers, in the folder that theirs are in."""
    own = tmp_path_factory.getbasetemp()
    return SharedFolders((own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "shared")


@pytest.fixture(scope="session")
def planned_scenes(shared_folders: SharedFolders) -> PlannedScenes:
    """The plans of this run."""
    return PlannedScenes(shared_folders)
