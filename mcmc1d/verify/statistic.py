"""What is tested of a position: a value whose CDF is known, or a cell whose probability is."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

Position: TypeAlias = Any
"""A pytree of arrays with a leading axis of n replicas: (n,), (n, d), or a dict or tuple of such."""


@dataclass(frozen=True)
class Continuous:
    """A real function of the position whose exact CDF is known and continuous."""

    value: Callable[[Position], np.ndarray]
    """Position of n replicas -> (n,)."""
    cdf: Callable[[np.ndarray], np.ndarray]
    """(n,) -> (n,), the probability of a value at most this."""

    def probability(self, where: Position) -> np.ndarray:
        """The CDF at n positions' values: uniform on [0, 1] under the law."""
        values = np.asarray(self.value(where), np.float64)
        try:
            return np.asarray(self.cdf(values), np.float64)
        except (TypeError, ValueError) as error:
            if isinstance(error, ValueError) and "truth value" not in str(error):
                raise
            raise ValueError(
                f"a cdf takes many values at once, of shape {values.shape}, and failed: {error}"
            ) from error


@dataclass(frozen=True)
class Discrete:
    """A function of the position to cells 0..c-1 whose exact probabilities are known."""

    cell: Callable[[Position], np.ndarray]
    """Position of n replicas -> (n,) integers; a position in none of the cells is -1."""
    masses: np.ndarray
    """(c,), summing to one."""
    labels: tuple[str, ...] = ()
    """Names of the cells for reports; numbers unless given."""
    ordered: bool = False
    """Whether the cells follow each other on the line, so that a CDF over them means something."""
    cut: bool = False
    """Whether the cells are intervals of a continuous value: what goes on inside of one is then not seen."""


Statistic: TypeAlias = Continuous | Discrete
