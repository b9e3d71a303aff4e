"""What every reformulation offers: it says what it accepts, applies itself, and inverts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.instance import Instance


class Form(Protocol):
    """What an instance became."""

    def invert(self, x: Array) -> Array:
        """The statement's variables (n,) in a solution of the form."""


@dataclass(frozen=True)
class Reformulated:
    """An instance whose first variables are those of the one it came from."""

    instance: Instance
    original_size: int  # variables of the statement; the rest are auxiliary
    relaxation: bool  # its optimal value bounds the original's from below

    def invert(self, x: Array) -> Array:
        """The statement's variables in a solution (n',) of the reformulated instance."""
        return x[: self.original_size].copy()


F = TypeVar("F", bound=Form, covariant=True)


class Reformulation(ABC, Generic[F]):
    """A way from an instance to a form that other methods solve, and back."""

    @abstractmethod
    def apply(self, instance: Instance) -> F:
        """The form; raises UsageError, in words, for an instance that is not accepted."""

    def accepts(self, instance: Instance) -> bool:
        """Whether `apply` has a form for the instance."""
        try:
            self.apply(instance)
        except UsageError:
            return False
        return True
