"""Targets made of targets: a power of one, as tempering samples it, and a sum of several."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_instance
from mcmc1d.examples import Examples
from mcmc1d.numerics import is_concrete, number
from mcmc1d.quadrature import Outline
from mcmc1d.special import log_sum
from mcmc1d.targets.base import Edges, Target
from mcmc1d.types import Array, Corners, Float, Scalar


class Tempered(Target):
    """exp(log_scale) f(x)^beta: f at the inverse temperature beta, 0 where f is 0 (for beta = 0 too)."""

    target: Target
    beta: Scalar = eqx.field(converter=number)
    log_scale: Scalar = eqx.field(converter=number, default=0.0)

    def __check_init__(self):
        require_instance(self.target, Target, "Tempered: the target")
        if is_concrete(self.beta, self.log_scale):
            beta, scale = np.asarray(self.beta), np.asarray(self.log_scale)
            require(
                bool(np.isfinite(beta) & (beta >= 0)),
                f"Tempered: beta is an inverse temperature, finite and not negative, not {beta}",
            )
            require(bool(np.isfinite(scale)), f"Tempered: log_scale must be finite, not {scale}")

    @property
    def domain(self) -> Corners:
        return self.target.domain

    @property
    def breaks(self) -> tuple[float, ...]:
        return self.target.breaks

    @property
    def outline(self) -> Outline:
        return self.target.outline

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        log_f = self.target.log_f(x)
        dark = jnp.isneginf(log_f)
        return jnp.where(dark, -jnp.inf, self.log_scale + self.beta * jnp.where(dark, 0, log_f))  # 0 times inf is NaN

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return self.quadrature(edges)


class Sum(Target):
    """f(x) = sum_i f_i(x), on the smallest interval or box that holds the domains of all."""

    targets: tuple[Target, ...]

    def __init__(self, targets: Sequence[Target]):
        """`targets`: the terms, one at least; their points have one shape."""
        self.targets = tuple(targets)
        require(len(self.targets) > 0, "Sum: give one target at least")
        for target in self.targets:
            require_instance(target, Target, "Sum: a term")
        shapes = {np.shape(target.domain[0]) for target in self.targets}
        require(len(shapes) == 1, f"Sum: the terms' points must have one shape, not {sorted(shapes)}")

    @property
    def domain(self) -> Corners:
        lowers, uppers = zip(*(target.domain for target in self.targets), strict=True)
        return np.min(np.asarray(lowers), axis=0), np.max(np.asarray(uppers), axis=0)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Those of the terms, and the ends of their domains, where one may drop to zero inside of another's."""
        points = set().union(*(target.breaks for target in self.targets))
        points.update(float(end) for target in self.targets for end in target.domain if np.ndim(end) == 0)
        return tuple(sorted(points))

    @property
    def outline(self) -> Outline:
        """Those of the terms, and the sides of their domains."""
        boxes = [Outline.box(*target.domain) for target in self.targets if np.shape(target.domain[0]) == (2,)]
        return Outline.together([*boxes, *(target.outline for target in self.targets)])

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        return log_sum([target.log_f(x) for target in self.targets])

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return np.sum([target.bin_masses(edges) for target in self.targets], axis=0)


def _examples() -> dict[str, Target]:
    from mcmc1d.targets.gaussian_mixture import walls_and_valley
    from mcmc1d.targets.sinusoid import Sinusoid
    from mcmc1d.targets.tables import Tabulated

    return {
        "tempered": Tempered(walls_and_valley(), 0.3, 0.7),
        "tempered_flat": Tempered(Tabulated([1, 0, 4, 2]), 0.0),
        "sum": Sum((Sinusoid(), Tempered(walls_and_valley(), 2.0), Tabulated([1, 0, 4, 2]))),
    }


EXAMPLES = Examples(_examples)
