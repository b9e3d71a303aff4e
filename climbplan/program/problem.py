"""A problem of a user's own: a program, and what methods may like to know beside it.

Everything but the program is optional. A statement is run code, so whatever it raises is named as
the statement's fault (`StatementError`), with the exception that it raised as its cause.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array
from climbplan.deprecation import RenamedAttribute
from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.program.residuals import BlockResidual
from climbplan.program.statement import Program

Theta = Mapping[str, ArrayLike]  # parameter block -> numbers


class StatementError(UsageError):
    """A statement that cannot be used, or that raised an exception of its own (the cause)."""


@dataclass(frozen=True)
class Problem:
    """A stated program with a name, and hints that some methods take.

    sample: draws parameters; datasets and libraries of neighbours need it.
    features: of parameters, a vector in which near means alike; the parameters themselves if
    left out.
    partitions: for McCormick, variable block -> number of equal pieces or increasing knots, the
    same for each entry of the block that is a factor of a product.
    start: a guess at parameters, variable block -> values; blocks left out start in the middle of
    their bounds.
    check: a checker of its own that does not read the statement, (theta, variable block -> values)
    -> name of a constraint -> its worst violation; 0 where it holds. Every answer has to pass it,
    at the tolerance at which the statement's own blocks are judged.
    Raises StatementError for a field that is not what it should be.
    """

    name: str
    program: Program
    sample: Callable[[np.random.Generator], Theta] | None = None
    features: Callable[[Theta], ArrayLike] | None = None
    partitions: Mapping[str, int | Sequence[float]] = field(default_factory=dict)
    start: Callable[[Theta], Mapping[str, ArrayLike]] | None = None
    check: Callable[[Theta, Mapping[str, Array]], Mapping[str, float]] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise StatementError(f"a problem's name must be text, got {self.name!r}")
        if not isinstance(self.program, Program):
            kind = type(self.program).__name__
            raise StatementError(f"problem {self.name!r}: `program` must be a Program, got {kind}")
        if not self.program.variables:
            raise StatementError(f"problem {self.name!r}: its program states no variables")
        for role in ("sample", "features", "start", "check"):
            value = vars(self)[role]
            if value is not None and not callable(value):
                raise StatementError(
                    f"problem {self.name!r}: `{role}` must be a function, "
                    f"got {type(value).__name__}"
                )
        for block, cut in self.partitions.items():
            self._check_partition(block, cut)

    def instance(self, theta: Theta) -> Instance:
        """Return the instance at theta."""
        self.numbers(theta)
        try:
            instance = self.program.instantiate(theta)
        except (ValueError, TypeError, RuntimeError) as error:  # RuntimeError: CasADi's only one
            raise StatementError(f"problem {self.name!r}: {error}") from error
        if not np.isfinite([*instance.q, *instance.P.data, instance.constant]).all():
            raise StatementError(f"problem {self.name!r}: a number of its cost is not finite")
        return instance

    def numbers(self, theta: Theta) -> dict[str, Array]:
        """Parameters as arrays; raises UsageError if they are missing, unknown or misshapen."""
        try:
            values = {name: np.asarray(value, float) for name, value in theta.items()}
            vector = self.program.theta(values)
        except (ValueError, TypeError) as error:
            raise UsageError(f"problem {self.name!r}: {error}") from error
        if not np.isfinite(vector).all():
            bad = [name for name, value in values.items() if not np.isfinite(value).all()]
            raise UsageError(f"problem {self.name!r}: {', '.join(bad)} not finite")
        return values

    def split(self, vector: Array) -> dict[str, Array]:
        """Parameters by block from one vector (p,), as `Program.theta` lays them out."""
        out, begin = {}, 0
        for name, shape in self.program.parameters.items():
            size = int(np.prod(shape, dtype=int))
            out[name] = np.asarray(vector[begin : begin + size], float).reshape(shape)
            begin += size
        if begin != len(vector):
            raise UsageError(
                f"problem {self.name!r}: {begin} parameters expected, got {len(vector)}"
            )
        return out

    def sample_parameters(self, rng: np.random.Generator) -> dict[str, Array]:
        """Draw parameters by the problem's own sampler; raises StatementError without one."""
        if self.sample is None:
            raise StatementError(f"problem {self.name!r} has no sampler: `sample` is not given")
        theta = self._call_statement("sample", self.sample, rng)
        if not isinstance(theta, Mapping):
            kind = type(theta).__name__
            raise StatementError(
                f"problem {self.name!r}: `sample` must return a mapping, got {kind}"
            )
        try:
            return self.numbers(theta)
        except StatementError:
            raise
        except UsageError as error:
            raise StatementError(f"{error} (from `sample`)") from error

    drawn = RenamedAttribute("sample_parameters")

    def feature_vector(self, theta: Theta) -> Array:
        """(d,) finite numbers; the parameters one after the other if nothing else is stated."""
        if self.features is None:
            return self.program.theta(self.numbers(theta))
        try:
            vector = np.asarray(
                self._call_statement("features", self.features, theta), float
            ).ravel()
        except (ValueError, TypeError) as error:
            raise StatementError(f"problem {self.name!r}: `features`: {error}") from error
        if not np.isfinite(vector).all():
            raise StatementError(f"problem {self.name!r}: `features` are not finite")
        return vector

    def start_point(self, theta: Theta, otherwise: Array) -> Array | None:
        """The stated guess (n,), entries of `otherwise` (n,) where it says nothing."""
        if self.start is None:
            return None
        guess = self._call_statement("start", self.start, theta)
        if not isinstance(guess, Mapping):
            kind = type(guess).__name__
            raise StatementError(
                f"problem {self.name!r}: `start` must return a mapping, got {kind}"
            )
        x = otherwise.copy()
        for block, values in guess.items():
            variable = self.program.variables.get(block)
            if variable is None:
                names = ", ".join(self.program.variables)
                raise StatementError(
                    f"problem {self.name!r}: `start` names {block!r}, its variables are {names}"
                )
            value = np.asarray(values, float)
            if value.shape != variable.shape or not np.isfinite(value).all():
                raise StatementError(
                    f"problem {self.name!r}: `start` of {block!r}: finite numbers of shape "
                    f"{variable.shape} expected, got shape {value.shape}"
                )
            x[variable.start : variable.stop] = value.ravel()
        return x

    def values(self, x: Array) -> dict[str, Array]:
        """Each variable block of a point (n,), in its shape."""
        return {name: self.program.value(name, x) for name in self.program.variables}

    def own_residuals(self, theta: Theta, x: Array) -> tuple[BlockResidual, ...]:
        """Return the residuals of the problem's own checker at a point (n,), as `own.NAME`.

        There are none without a checker.

        Raises:
            StatementError: The checker does not return numbers by name.
        """
        if self.check is None:
            return ()
        residuals = self._call_statement("check", self.check, theta, self.values(x))
        try:
            worst = {str(name): float(value) for name, value in residuals.items()}
        except (AttributeError, TypeError, ValueError) as error:
            raise StatementError(
                f"problem {self.name!r}: `check` must return a number by name: {error}"
            ) from error
        return tuple(
            BlockResidual(f"own.{name}", np.inf if np.isnan(value) else max(value, 0.0), "", ())
            for name, value in worst.items()
        )

    def _call_statement(self, role: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function of the statement, and name its exceptions."""
        try:
            return function(*arguments)
        except (Exception, SystemExit) as error:  # not ours: whatever it raises is its message
            raise StatementError(
                f"problem {self.name!r}: `{role}` raised {type(error).__name__}: {error}"
            ) from error

    def _check_partition(self, block: str, cut: int | Sequence[float]) -> None:
        where = f"problem {self.name!r}: partition of {block!r}"
        variable = self.program.variables.get(block)
        if variable is None or variable.integer:
            continuous_names = ", ".join(
                n for n, v in self.program.variables.items() if not v.integer
            )
            raise StatementError(
                f"{where}: no such continuous variable, there are {continuous_names}"
            )
        if isinstance(cut, int):
            if isinstance(cut, bool) or cut < 1:
                raise StatementError(f"{where}: at least one piece expected, got {cut!r}")
            return
        knots = np.asarray(cut, float)
        if knots.ndim != 1 or len(knots) < 2 or not (np.diff(knots) > 0).all():
            raise StatementError(f"{where}: a number of pieces or increasing knots expected")
