"""What a run accumulates on the fly: sums over steps and chains, never the chains themselves."""

import abc
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_cover, require_instance, rising
from mcmc1d.examples import Examples
from mcmc1d.metropolis import Deposits, Kernel, Step
from mcmc1d.state import Multiplexed
from mcmc1d.types import Array, Float, Scalar


class Estimator(eqx.Module):
    """Sums over the steps of many chains.

    `update` is handed the steps of all chains of a block at once (the chains are the last axis of each leaf, so that
    deposits have x of shape (n, ..., chains) and weights of shape (n, chains)) and adds them to the accumulator, a
    pytree of sums that starts at zero. Its real numbers are float64 whatever the chains are in, because a float32 sum
    would round thousands of deposits alike; so `update` is traced with JAX's x64 on.
    """

    reads_deposits: ClassVar[bool] = True
    """Whether `update` looks at what is deposited, which must be samples of one thing then."""

    @abc.abstractmethod
    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Any:
        """The accumulator at zero, in `dtype`; raises `ValueError` where the estimator does not fit the target.

        `target`: what the kernel's deposits are samples of, which need not be the chain's own; see `Kernel.sampled`.
        """

    @abc.abstractmethod
    def update(self, sums: Any, steps: Step) -> Any:
        """`sums` with the deposits of one step of every chain added."""


def empty(estimator: Estimator, target: Multiplexed, kernel: Kernel, dtype: Any) -> Any:
    """An estimator's accumulator at zero, for what the kernel deposits: of 64 bits, whatever the chains' dtype is."""
    of = kernel.sampled(target) if estimator.reads_deposits else target
    zeros = estimator.init(of, kernel, dtype)
    with jax.enable_x64(True):
        return jax.tree.map(lambda leaf: jnp.zeros(jnp.shape(leaf), _WIDE.get(jnp.asarray(leaf).dtype.kind)), zeros)


_WIDE = {"f": jnp.float64, "i": jnp.int64, "u": jnp.uint64, "c": jnp.complex128}
"""What sums of each kind of number are kept in."""


def added(estimator: Estimator, sums: Any, steps: Step) -> Any:
    """What `update` makes of an accumulator of `empty`; it is traced with JAX's x64 on."""

    def kept(old: Array, new: Any) -> Array:
        new = jnp.asarray(new)
        require(
            new.dtype.kind == old.dtype.kind,
            f"{type(estimator).__name__}.update returned {new.dtype} for a sum that init made {old.dtype}",
        )
        return new.astype(old.dtype)

    with jax.enable_x64(True):
        return jax.tree.map(kept, sums, estimator.update(sums, steps))


def require_estimators(estimators: Mapping[str, Estimator] | None) -> dict[str, Estimator]:
    """The estimators by name, or `ValueError` where what was given is not that."""
    asked = {} if estimators is None else estimators
    require(isinstance(asked, Mapping), f"run: give estimators by name, a dict, not a {type(asked).__name__}")
    return {name: require_instance(asked[name], Estimator, f"run: the estimator {name!r}") for name in asked}


def add_deposits(
    sums: Float[Array, "..."], deposits: Deposits, place: Callable[[Float[Array, "..."]], Array], *, joint: bool
) -> Float[Array, "..."]:
    """`sums`, of shape (bins,) or if `joint` (n_techniques, bins), with the weight of each deposit in its bin added.

    `place` is the bin of the x of every chain: (chains,) integers within bounds.
    """

    def add(sums: Array, deposit: Deposits) -> tuple[Array, None]:
        where = (deposit.index, place(deposit.x)) if joint else (place(deposit.x),)
        weight = deposit.weight.astype(sums.dtype)
        return sums.at[where].add(weight, mode="promise_in_bounds", wrap_negative_indices=False), None

    # Of two states or a few candidates no loop is left, of hundreds a short one: compiling must not grow with them.
    return jax.lax.scan(add, sums, deposits, unroll=8)[0]


class Histogram(Estimator):
    """The deposits' weight in each bin of a scalar x: sums of shape (bins,), or (n_techniques, bins) if `joint`.

    Divided by the steps it converges to the bin masses of f / b, jointly to those of w_i f / b.
    """

    edges: np.ndarray
    joint: bool = eqx.field(static=True)
    regular: bool = eqx.field(static=True)

    def __init__(self, bins: int | ArrayLike = 100, *, joint: bool = False, domain: tuple[float, float] | None = None):
        """`bins`: how many equal ones over the `domain` ([0, 1]), or their edges; `joint`: by technique as well."""
        self.regular = np.ndim(bins) == 0
        if self.regular:
            count = np.asarray(bins)  # a NumPy integer will do as well
            require(
                np.issubdtype(count.dtype, np.integer) and int(count) >= 1,
                f"Histogram: bins must be a whole number, 1 at least, or edges, not {bins}",
            )
            self.edges = rising(np.linspace(*((0, 1) if domain is None else domain), int(count) + 1), "Histogram")
        else:
            require(domain is None, "Histogram: the edges say what its domain is; give no domain beside them")
            self.edges = rising(bins, "Histogram")
        self.joint = joint

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Float[Array, "..."]:
        lower, upper = target.target.domain
        require(np.ndim(lower) == 0, "Histogram: x must be a scalar")
        require_cover("Histogram", self.edges, (lower, upper), type(target.target).__name__)
        bins = self.edges.shape[0] - 1
        return jnp.zeros((target.n_techniques, bins) if self.joint else bins, dtype)

    def update(self, sums: Float[Array, "..."], steps: Step) -> Float[Array, "..."]:
        return add_deposits(sums, steps.deposits, self._bin, joint=self.joint)

    def _bin(self, x: Float[Array, "..."]) -> Array:
        bins = self.edges.shape[0] - 1
        if self.regular:
            lower, upper = self.edges[0], self.edges[-1]
            cell = ((x - lower) * (bins / (upper - lower))).astype(jnp.int32)
        else:
            cell = jnp.searchsorted(jnp.asarray(self.edges, x.dtype), x, side="right") - 1
        return jnp.clip(cell, 0, bins - 1)


class Acceptance(Estimator):
    """For each kind of move: the sum of its acceptance probabilities, and how often it was proposed.

    The sums are two arrays of shape (kinds,); their ratio is the acceptance rate.
    """

    reads_deposits: ClassVar[bool] = False

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> tuple[Array, Array]:
        zero = jnp.zeros(len(kernel.kinds), dtype)
        return zero, zero

    def update(self, sums: tuple[Array, Array], steps: Step) -> tuple[Array, Array]:
        info, (accepted, proposed) = steps.info, sums
        # Summed by comparison, not by scatter: there are few kinds and many chains.
        kinds = range(proposed.shape[0])
        gained = jnp.stack([jnp.where(info.kind == k, info.acceptance, 0).sum(dtype=accepted.dtype) for k in kinds])
        tried = jnp.stack([(info.kind == k).sum(dtype=proposed.dtype) for k in kinds])
        return accepted + gained, proposed + tried


class Expectation(Estimator):
    """The weighted sum of a function of x over the deposits; divided by the steps, its expectation under f / b.

    The function returns a number, an array, or a tree of them, and so are the sums.
    """

    function: Any

    def __check_init__(self):
        require(callable(self.function), f"Expectation: give a function of x, not {self.function!r}")

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Any:
        x = jnp.broadcast_to(jnp.asarray(target.target.domain[0], dtype), np.shape(target.target.domain[0]))
        found = eqx.filter_eval_shape(lambda x: jax.tree.map(jnp.asarray, self.function(x)), x)
        return jax.tree.map(lambda y: jnp.zeros(y.shape, jnp.result_type(y.dtype, dtype)), found)

    def update(self, sums: Any, steps: Step) -> Any:
        def one(x: Float[Array, "..."], weight: Scalar) -> Any:
            return jax.tree.map(lambda y: y * weight, self.function(x))

        deposits = steps.deposits
        with jax.enable_x64(deposits.x.dtype == jnp.float64):  # the function is traced as the chains are
            # The chains are the last axis of x, after its own.
            found = jax.vmap(jax.vmap(one, in_axes=-1))(deposits.x, deposits.weight)
        return jax.tree.map(lambda total, new: total + new.sum((0, 1), dtype=total.dtype), sums, found)


EXAMPLES = Examples(
    lambda: {
        "histogram": Histogram(50),
        "joint_histogram": Histogram([0, 0.2, 0.5, 0.9, 1.0], joint=True),
        "acceptance": Acceptance(),
        "expectation": Expectation(lambda x: x * x),
    }
)
