"""Interface of reformulations, which map instances to forms and invert their solutions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.instance import Instance


class Form(Protocol):
    """The result of a reformulation."""

    def invert(self, x: Array) -> Array:
        """Return the statement's variables (n,) in a solution of the form."""


@dataclass(frozen=True)
class Reformulated:
    """An instance whose first variables are those of the original instance."""

    instance: Instance
    original_size: int  # number of variables of the statement; the rest are auxiliary
    relaxation: bool  # whether its optimal value bounds the original's from below

    def invert(self, x: Array) -> Array:
        """Return the statement's variables in a solution (n',) of the reformulated instance."""
        return x[: self.original_size].copy()


F = TypeVar("F", bound=Form, covariant=True)


class Reformulation(ABC, Generic[F]):
    """A map from an instance to a form that other methods solve, and back."""

    @abstractmethod
    def apply(self, instance: Instance) -> F:
        """Build the form of an instance.

        Raises:
            UsageError: The instance is not accepted.
        """

    def accepts(self, instance: Instance) -> bool:
        """Return whether `apply` has a form for the instance."""
        try:
            self.apply(instance)
        except UsageError:
            return False
        return True
