"""The state of a chain, and the density it samples: a target seen through several techniques at once."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_cover, require_instance, require_mass, require_planar_cover, rising
from mcmc1d.numerics import is_concrete
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.probes import require_sound
from mcmc1d.quadrature import Outline, integrate, integrate_plane
from mcmc1d.targets import DensityOf, Target
from mcmc1d.targets.base import Edges, pair_of_edges
from mcmc1d.techniques import Family, Looked, Several, Technique, checked_shape, sample_shape
from mcmc1d.techniques.planar import outlines
from mcmc1d.types import Array, Float, Index, Scalar
from mcmc1d.weights import Balance, FromFunction, Weights


class Eval(eqx.Module):
    """All that one evaluation of (index, u) found out, kept so that a jump need not ask again."""

    x: Float[Array, "..."]
    v: Float[Array, " k"]
    """What of u the sample forgets, the numbers that the technique does not read included."""
    log_det: Scalar
    """log|d(x, v)/du| of the technique in use."""
    log_f: Scalar
    log_p: tuple[Scalar, ...]
    """log p_i(x), with respect to dx, of every technique."""
    log_c: Scalar
    """log C_i(u), the log-density of the state."""
    kept: Any = ()
    """What the target found at x beside log f; see `Target.look`."""


class State(eqx.Module):
    """A point of multiplexed primary sample space: a technique's index and the uniform numbers u in [0, 1)^m.

    `eval` is None while nothing has been evaluated; `Multiplexed.evaluate` fills it.
    """

    index: Index
    u: Float[Array, " m"]
    eval: Eval | None = None

    @property
    def seen(self) -> Eval:
        """`eval`, of a state that has been evaluated."""
        if self.eval is None:
            raise ValueError("this state has not been evaluated; see Multiplexed.evaluate")
        return self.eval


class Multiplexed(eqx.Module):
    """The target f seen through techniques S_i and weights w_i: the density on (i, u) that a chain samples.

    C_i(u) = w_i(x) f(x) / p_i(x) at x = S_i(u), with respect to counting measure on i and du on [0, 1)^m, m being
    the number that the hungriest technique reads (Hachisuka et al. 2014, eq. 16; Bitterli et al. 2017, eq. 4). Its
    marginal in x is f / b, and given x that of the technique is w_i(x).

    Making one looks at f, p and w on a grid of `probes` points and raises `ValueError` where the density is NaN,
    infinite, negative or zero everywhere, where the weights do not sum to one or are positive where their
    technique's density is zero, and where no technique reaches f.
    """

    target: Target
    family: Family
    weights: Weights

    def __init__(
        self,
        target: Target,
        techniques: Technique | Sequence[Technique] | Family,
        weights: Weights | Callable[[Array, Array], Array] | None = None,
        *,
        probes: int = 2048,
    ):
        """`weights`: the balance heuristic unless given; a function (x, p[n]) -> w[n] will do.

        `techniques`: one, several, or a `Family` of those that share their work. `probes`: 0 looks at none, for
        targets that are known to be sound.
        """
        forget_what_has_changed(target, techniques, weights)
        require_instance(target, Target, "Multiplexed: the target", "; FromFunction makes one of a function")
        self.target = target
        if not isinstance(techniques, Family):
            listed = tuple(techniques) if isinstance(techniques, Sequence) else (techniques,)
            for technique in listed:
                checked_shape(require_instance(technique, Technique, "Multiplexed: a technique"))
            techniques = Several(listed)
        self.family = techniques
        if weights is None:
            weights = Balance()
        own = not isinstance(weights, type) and callable(weights)
        if not own:
            require_instance(weights, Weights, "Multiplexed: the weights", ", nor a function (x, p) -> w")
        if is_concrete(*target.domain):
            bounded = all(bool(np.isfinite(np.asarray(end)).all()) for end in target.domain)
            require(bounded, f"Multiplexed: the domain of {type(target).__name__} must be bounded, not {target.domain}")
        self.weights = weights if isinstance(weights, Weights) else FromFunction(weights)
        require(len(self.techniques) > 0, "Multiplexed: give one technique at least")
        shapes = {sample_shape(technique) for technique in self.techniques} | {np.shape(target.domain[0])}
        require(
            len(shapes) == 1,
            f"Multiplexed: the target's points and the techniques' samples must have one shape, not {sorted(shapes)}",
        )
        if probes and is_concrete(self.target, self.family, self.weights):
            require_sound(self.target, self.family, self.weights, probes)

    @property
    def techniques(self) -> tuple[Technique, ...]:
        """The techniques, in the order of the index."""
        return self.family.members

    @property
    def n_techniques(self) -> int:
        """How many techniques there are: the constant by which a uniform choice of one multiplies."""
        return len(self.techniques)

    @property
    def dim_u(self) -> int:
        """m, the length of the state's u."""
        return self.family.dim_u

    @property
    def dim_v(self) -> int:
        """How many numbers v has, k = m - d."""
        return self.dim_u - int(np.prod(np.shape(self.target.domain[0])))

    @property
    def breaks(self) -> tuple[float, ...]:
        """Where in x the target, a technique's density or the weights may jump or bend."""
        points = set(self.target.breaks).union(*(technique.breaks for technique in self.techniques))
        points.update(float(end) for t in self.techniques for end in t.support if np.ndim(end) == 0)
        return tuple(sorted(points.union(self.weights.breaks)))

    def forward(self, index: Index, u: Float[Array, " m"]) -> tuple[Array, Array, Scalar]:
        """(x, v, log|d(x, v)/du|) of technique `index`; what it does not read of u closes its v."""
        return self.family.forward(index, u)

    def inverse(self, index: Index, x: Float[Array, "..."], v: Float[Array, " k"]) -> tuple[Array, Scalar]:
        """(u, log|du/d(x, v)|) of technique `index`, the inverse of `forward`."""
        return self.family.inverse(index, x, v)

    def evaluate(self, state: State) -> State:
        """The state with its `eval` filled in; as it is where that has been done."""
        if state.eval is not None:
            return state
        seen = Looked(*self.family.look(self.target, state.index, state.u))
        log_c = self.log_c(state.index, seen.x, seen.log_f, seen.log_p, self.family.probs(seen.x))
        found = Eval(seen.x, seen.v, seen.log_det, seen.log_f, seen.log_p, log_c, seen.kept)
        return State(state.index, state.u, found)

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        """Log w_i(x) of every technique."""
        return self.weights.log_weights(x, log_p)

    def log_c(
        self,
        index: Index,
        x: Float[Array, "..."],
        log_f: Scalar,
        log_p: Sequence[Scalar],
        p: Sequence[Scalar] | None = None,
    ) -> Scalar:
        """Log w_i(x) f(x) / p_i(x); -inf where the target, or the technique's share of it, is zero.

        `p`: the densities themselves, where they are at hand.

        Where the target, a technique's density, a weight or the point itself is NaN it is +inf: no law is defined, and
        to reject silently would make one up. A chain that comes there stays, so that whoever looks at its state when it
        is done finds it; the runner does.
        """
        log_ratio = self.weights.log_ratio(x, log_p, index, p)
        # Whatever the weights are; or whatever the target is, at a pole that the technique has as well.
        dark = jnp.isneginf(log_f) | (jnp.isneginf(log_ratio) & ~jnp.isnan(log_f))
        log_c = jnp.where(dark, -jnp.inf, log_ratio + log_f)
        return jnp.where(jnp.isnan(log_c) | jnp.isnan(x).any(), jnp.inf, log_c)

    def complaint(self, state: State) -> str:
        """What is not a number at an evaluated state whose density is not finite, and where that is."""
        seen, i = state.seen, int(state.index)
        if np.isfinite(seen.log_c):
            return (
                f"{type(self.target).__name__}: the density's logarithm reaches {float(seen.log_c):.4g}, and it is "
                f"infinite in {seen.log_c.dtype}: subtract a constant from log f, no law depends on it"
            )
        x, u = np.asarray(seen.x), np.asarray(state.u)
        undefined = [k for k, log_p in enumerate(seen.log_p) if np.isnan(log_p)]
        if np.isnan(x).any():
            return f"technique {i} ({type(self.techniques[i]).__name__}): its sample is NaN at u = {u}"
        if np.isnan(seen.log_f):
            return self.target.complaint(x)
        if undefined:
            k = undefined[0]
            return f"technique {k} ({type(self.techniques[k]).__name__}): its log_prob is NaN at x = {x}"
        if np.isinf(seen.log_f):
            return f"{type(self.target).__name__} is infinite at x = {x}"
        return f"{type(self.weights).__name__}: the weight of technique {i} is not finite at x = {x}"

    def joint_masses(self, edges: Edges) -> np.ndarray:
        """The exact law of (technique, x): the integral of w_i f / b over each bin, of shape (n_techniques, bins).

        In the plane `edges` are a pair (x_edges, y_edges), and the shape is (n_techniques, nx, ny). By adaptive
        quadrature, split where f, p and w are known to jump; its sum over the techniques is the law of x, which
        `target.bin_masses` gives independently. Raises `ValueError` where the bins do not cover the domain, and where
        1e-11 of the whole (1e-10 in the plane) is out of reach: for a jump that no `breaks` and no `outline` names.
        """
        who, domain, name = "joint_masses", self.target.domain, type(self.target).__name__
        if np.ndim(domain[0]) == 0:
            edges = rising(edges, who)
            require_cover(who, edges, domain, name)
            masses = integrate(Shares(self), edges, self.breaks)[0].T
            return masses / require_mass(masses.sum(), who, name)
        x_edges, y_edges = (rising(part, who) for part in pair_of_edges(edges, who))
        require_planar_cover(who, x_edges, y_edges, domain, name)
        known = [self.target.outline, Outline.box(*domain)]
        known += [outline for technique in self.techniques for outline in outlines(technique)]
        masses = np.moveaxis(integrate_plane(Shares(self), x_edges, y_edges, known)[0], -1, 0)
        return masses / require_mass(masses.sum(), who, name)


class Shares(eqx.Module):
    """w_i(x) f(x) for every technique, (n,), as a function of x: what joint masses are integrals of."""

    target: Multiplexed

    def __call__(self, x: Scalar) -> Float[Array, " n"]:
        log_p = self.target.family.log_probs(x)
        weights = jnp.exp(jnp.stack(list(self.target.weights.log_weights(x, log_p))))
        f = DensityOf(self.target.target)(x)
        return jnp.where(f > 0, weights * f, 0)
