"""Whether Ctrl-C or the clock stopped SCIP."""

from __future__ import annotations

import pytest

from climbplan.solvers.scip_run import run_model


class Stopped:
    """A model that something interrupts at once."""

    def __init__(self) -> None:
        self.settings: dict[str, object] = {}

    def setParam(self, name: str, value: object) -> None:
        self.settings[name] = value

    def optimizeNogil(self) -> None:
        """Nothing is solved."""

    def interruptSolve(self) -> None:
        """Nothing runs."""

    def getStatus(self) -> str:
        return "userinterrupt"


def test_ctrl_c_is_no_limit() -> None:
    with pytest.raises(KeyboardInterrupt):
        run_model(Stopped(), 1e-4, 1e-5, 60.0)


def test_a_limit_is_no_ctrl_c() -> None:
    model = Stopped()
    run_model(model, 1e-4, 1e-5, 0.0)
    assert model.settings["limits/time"] == 0.0
    assert model.settings["limits/gap"] == pytest.approx(9e-5)
