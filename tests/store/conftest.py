"""The example climb and its file."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import h5py
import pytest
from example_climb import Climb, example_climb

from climbplan.climb.plan.file import write_climb

Editor = Callable[[], AbstractContextManager[h5py.File]]


@pytest.fixture(scope="session")
def climb() -> Climb:
    """Two rounds of SiLVIA between walls."""
    return example_climb()


@pytest.fixture(scope="session")
def original(climb: Climb, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example's file, not to be changed."""
    path = tmp_path_factory.mktemp("plans") / "plan.h5"
    write_climb(climb.plan, path)
    return path


@pytest.fixture
def plan_file(original: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copy(original, tmp_path / "plan.h5"))


@pytest.fixture
def edited(plan_file: Path) -> Editor:
    """Opens the copy for changes."""

    @contextmanager
    def edit() -> Iterator[h5py.File]:
        with h5py.File(plan_file, "r+") as file:
            yield file

    return edit
