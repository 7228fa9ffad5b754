"""Importance functions (Hoberock and Hart 2010): what a chain samples in place of f, while it deposits f / I.

An importance function is a `Target` like any other, f among them, and a chain samples it by `Multiplexed(I, ...)`.
The ones here are made of others; `image.Image` deposits, and refuses an I that vanishes where f does not.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_instance, require_positive
from mcmc1d.compiling import quickly
from mcmc1d.examples import Examples
from mcmc1d.numerics import cast, is_concrete, parameter
from mcmc1d.pixels import Pixels, masses
from mcmc1d.quadrature import Outline, integrate, midpoints
from mcmc1d.targets import DensityOf, Target
from mcmc1d.targets.base import Edges, unit_cube
from mcmc1d.types import Array, Corners, Float, Index, Real, Scalar


class Product(Target):
    """I = I_1 I_2 ...: importance functions chained together (section 4), on one domain."""

    factors: tuple[Target, ...]

    def __init__(self, factors: Sequence[Target]):
        """`factors`: one at least; f itself is one of them as a rule."""
        self.factors = tuple(factors)
        require(len(self.factors) > 0, "Product: give one factor at least")
        for factor in self.factors:
            require_instance(factor, Target, "Product: a factor", "; targets.FromFunction makes one of a function")
        domains = [np.asarray(factor.domain) for factor in self.factors if is_concrete(factor.domain)]
        require(
            all(np.array_equal(domain, domains[0]) for domain in domains),
            f"Product: the factors must have one domain, not {[domain.tolist() for domain in domains]}",
        )

    @property
    def domain(self) -> Corners:
        return self.factors[0].domain

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted({point for factor in self.factors for point in factor.breaks}))

    @property
    def outline(self) -> Outline:
        return Outline.together([factor.outline for factor in self.factors])

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        return sum((factor.log_f(x) for factor in self.factors[1:]), start=self.factors[0].log_f(x))

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return self.quadrature(edges)

    def complaint(self, x: ArrayLike) -> str:
        undefined = [factor for factor in self.factors if not self_defined(factor, x)]
        return f"Product: {undefined[0].complaint(x)}" if undefined else f"Product is undefined at x = {x}: 0 * inf"


class OverBase(Target):
    """An importance function made of one other, on the domain of that."""

    base: eqx.AbstractVar[Target]

    @property
    def domain(self) -> Corners:
        return self.base.domain

    @property
    def outline(self) -> Outline:
        return self.base.outline

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return self.quadrature(edges)

    def complaint(self, x: ArrayLike) -> str:
        return self.base.complaint(x)


class Floor(OverBase):
    """I = max(base, level): nothing of the domain is left without samples."""

    base: Target
    level: Scalar = eqx.field(converter=parameter, default=0.01)
    kinks: tuple[float, ...] = eqx.field(static=True, default=())
    """Where in x the floor is reached, for quadrature in one dimension."""

    def __check_init__(self):
        require_instance(self.base, Target, "Floor: the base")
        require_positive(self, level=self.level)

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted({*self.base.breaks, *self.kinks}))

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        lower, upper = self.domain
        inside = jnp.all((x >= jnp.asarray(lower)) & (x <= jnp.asarray(upper)))
        # `maximum` hands a NaN of the base on.
        return jnp.where(inside, jnp.maximum(self.base.log_f(x), jnp.log(jnp.asarray(self.level))), -jnp.inf)


class Shader(OverBase):
    """I = base, times `factor` where a predicate of x holds: an importance shader (section 4.1, which has 10)."""

    base: Target
    predicate: Callable[[Array], Array]
    factor: Scalar = eqx.field(converter=parameter, default=10.0)
    kinks: tuple[float, ...] = eqx.field(static=True, default=())
    """Where in x the predicate changes, for quadrature in one dimension."""

    def __check_init__(self):
        require_instance(self.base, Target, "Shader: the base")
        if is_concrete(self.factor):
            factor = np.asarray(self.factor)
            require(
                bool(np.isfinite(factor) and factor >= 0),
                f"Shader: factor must be finite and not negative, not {self.factor}; 0 loses what it hides",
            )

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted({*self.base.breaks, *self.kinks}))

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        return self.base.log_f(x) + jnp.where(self.predicate(x), jnp.log(jnp.asarray(self.factor)), 0)


class Regions(Target):
    """I is constant on each of k (or k x k) equal regions of the image: a table, whose numbers may be traced.

    A new table of as many numbers, and a new `regions` k, does not recompile what samples it.
    """

    values: Float[Real, "..."]
    regions: Index
    hidden: int = eqx.field(static=True)

    def __init__(self, values: ArrayLike, regions: Index | None = None, hidden: int = 0):
        """`values`: of shape (n,) or (n, n), of which the first k a side count; `hidden`: coordinates of x beyond."""
        self.values = parameter(values)
        self.regions = np.asarray(self.values.shape[0], np.int32) if regions is None else regions
        self.hidden = hidden
        shape = self.values.shape
        require(
            len(shape) in (1, 2) and len(set(shape)) == 1,
            f"Regions: the values must be a line or a square, not of shape {shape}",
        )
        if is_concrete(self.values, self.regions):
            k = int(self.regions)
            require(1 <= k <= shape[0], f"Regions: regions must lie in 1..{shape[0]}, not {k}")
            used = np.asarray(self.values)[(slice(k),) * len(shape)]
            bad = np.argwhere(~(np.isfinite(used) & (used >= 0)))
            require(
                not len(bad),
                f"Regions: an importance is finite and not negative; region {tuple(bad[:1].ravel().tolist())} of {k} "
                f"a side has {used[tuple(bad[0])] if len(bad) else ''}",
            )

    @property
    def domain(self) -> Corners:
        return unit_cube(self.values.ndim + self.hidden)

    @property
    def breaks(self) -> tuple[float, ...]:
        return () if self.values.ndim + self.hidden > 1 else tuple(self._lines().tolist())

    @property
    def outline(self) -> Outline:
        lines = self._lines() if self.values.ndim + self.hidden == 2 else np.zeros(0)
        return Outline.lines(lines, lines if self.values.ndim == 2 else np.zeros(0))

    def _lines(self) -> np.ndarray:
        """The inner ends of the regions along an axis."""
        return np.arange(1, int(self.regions)) / int(self.regions)

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        cell = Pixels(self.values.shape[0], self.values.ndim).cell(x, self.regions)
        value = jnp.asarray(self.values).reshape(-1)[cell]
        return jnp.where(jnp.all((x >= 0) & (x <= 1)), jnp.log(value), -jnp.inf)

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return self.quadrature(edges)


def self_defined(target: Target, x: ArrayLike) -> bool:
    """Whether log f(x) is a number or -inf."""
    value = np.asarray(target.log_f(jnp.asarray(x)))
    return not bool(np.isnan(value) | np.isposinf(value))


class _Lost(Target):
    """f where I is zero, and zero elsewhere."""

    f: Target
    importance: Target

    @property
    def domain(self) -> Corners:
        return self.f.domain

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted({*self.f.breaks, *self.importance.breaks}))

    @property
    def outline(self) -> Outline:
        return Outline.together([self.f.outline, self.importance.outline])

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        return jnp.where(jnp.isneginf(self.importance.log_f(x)), self.f.log_f(x), -jnp.inf)

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return self.quadrature(edges)


def lost_mass(f: Target, importance: Target, cuts: Sequence[Sequence[float]] = ()) -> tuple[float, float]:
    """The integral of f over where I vanishes, and over all: what Algorithm 1 loses of what, exactly.

    In one dimension by adaptive quadrature between the `breaks` of both, in more by `masses` between the `cuts`;
    `ValueError` where that does not converge, because the places at which I starts to vanish are not among them.
    """
    lost = _Lost(f, importance)
    if np.ndim(f.domain[0]) == 0:
        ends = np.array([float(end) for end in f.domain])
        parts = [integrate(DensityOf(part), ends, lost.breaks)[0][0] for part in (f, lost)]
        return float(parts[1]), float(parts[0])
    edges = list(np.stack([np.asarray(end, np.float64) for end in f.domain], 1))
    return float(masses(lost, edges, cuts).sum()), float(masses(f, edges, cuts).sum())


@quickly
def _both(f: Target, importance: Target, points: Float[Array, "n ..."]) -> tuple[Array, Array]:
    return jax.vmap(f.log_f)(points), jax.vmap(importance.log_f)(points)


def require_importance(f: Target, importance: Target, *, allow_loss: bool = False, probes: int = 2048) -> None:
    """Raise `ValueError` unless I is finite, not negative, and positive where f is, on a grid of probes.

    The message names the first bad point and the mass that would be lost; `allow_loss` lets an I vanish.
    """
    require_instance(importance, Target, "the importance function", "; targets.FromFunction makes one of a function")
    points = midpoints(*f.domain, probes)
    name = type(importance).__name__
    with jax.enable_x64(True):
        both = _both(cast(f, jnp.float64), cast(importance, jnp.float64), jnp.asarray(points))
        log_f, log_i = (np.asarray(a) for a in both)
        bad = np.isnan(log_i) | np.isposinf(log_i)
        if bad.any():
            raise ValueError(f"importance function: {importance.complaint(points[np.argmax(bad)])}")
    lost = np.isneginf(log_i) & ~np.isneginf(log_f)
    if allow_loss or not lost.any():
        return
    k = int(np.argmax(lost))
    try:
        mass, whole = lost_mass(f, importance)
        share = f"{mass:.6g} of a mass of {whole:.6g} would be lost"
    except ValueError:  # the places where it vanishes were not named
        share = f"about {np.exp(log_f[lost]).sum() / np.exp(log_f).sum():.2%} of the mass would be lost"
    raise ValueError(
        f"importance function: {name} is zero at x = {points[k]}, where f = {np.exp(log_f[k]):.6g}: {share}; put a "
        "Floor under it, or say allow_loss=True"
    )


def require_sampled(target: Target, importance: Target) -> None:
    """Raise `ValueError` unless samples of `target` are samples of I: the two may differ by a factor."""
    if eqx.tree_equal(target, importance):  # which is known of two functions while they are traced, too
        return
    names = f"the importance function {type(importance).__name__}; its target, {type(target).__name__},"
    ends = [np.asarray(end, np.float64) for one in (target, importance) for end in one.domain]
    alike = np.allclose(ends[0], ends[2], rtol=1e-6) and np.allclose(ends[1], ends[3], rtol=1e-6)
    require(alike, f"Image: the chain must sample {names} has another domain")
    points = midpoints(*importance.domain, 256)
    with jax.enable_x64(True):
        both = _both(cast(target, jnp.float64), cast(importance, jnp.float64), jnp.asarray(points))
        log_f, log_i = (np.asarray(a) for a in both)
    with np.errstate(invalid="ignore"):
        apart = np.where(np.isneginf(log_f) & np.isneginf(log_i), 0, log_f - log_i)
    lit = np.isfinite(apart) & np.isfinite(log_f)
    factor = np.median(apart[lit]) if lit.any() else 0.0
    # The runner has cast both to its own precision; what float32 does to a logarithm is far below this.
    off = ~(np.abs(np.where(np.isfinite(log_f), apart - factor, apart)) <= 1e-2)
    k = int(np.argmax(off))
    require(
        not off.any(),
        f"Image: the chain must sample {names} is another density: at x = {points[k]} their logarithms are "
        f"{log_i[k]:.6g} and {log_f[k]:.6g}, {factor:.6g} apart at most places",
    )


def _examples() -> dict[str, Target]:
    from mcmc1d.targets import Sinusoid

    f = Sinusoid()
    return {
        "product": Product((f, Regions([1, 4, 0.5, 2]))),
        "floor": Floor(Sinusoid(1.0), 0.3),
        "shader": Shader(f, lambda x: x < 0.25, 10.0, (0.25,)),
        "regions": Regions(np.ones((4, 4)), 3),
        "lost": _Lost(f, Regions([1, 0])),
    }


EXAMPLES = Examples(_examples)
