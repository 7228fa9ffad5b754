"""Positions, densities and supports of another shape, precision or scale than a test takes: told, or looked at rightly.

At level 1e-5 a right kernel fails with that probability.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import beta, gamma, poisson, zipf

from mcmc1d import Multiplexed
from mcmc1d.metropolis import Deposits, Info, Kernel, Step
from mcmc1d.state import State
from mcmc1d.targets import Tabulated
from mcmc1d.techniques import Uniform
from mcmc1d.verify import Discrete, HostKernel, JaxKernel, Law, LawError, Verdict, forgetting, step_operator, verify
from mcmc1d.verify.ends import interval
from mcmc1d.verify.kernels import HostSubject
from mcmc1d.verify.law import multiplexed_law
from mcmc1d.verify.outcomes import StepFlux
from mcmc1d.verify.sampler import Sampler
from mcmc1d.verify.subject import Look, Picked, joined, key_of

SIZE = {"replicas": 2**13}
UNIT = (np.linspace(0, 1, 9), np.ones(8))
SAME = HostKernel(lambda rng, x: x)


def normal(rng, n):
    return rng.normal(size=n)


def pairs(rng, n):
    return rng.normal(size=(n, 2))


def deposits_without_a_name(state, info):
    return state["x"][None], jnp.ones(1)


@pytest.mark.parametrize(
    ("kernel", "law", "message"),
    [
        (SAME, {"sample": lambda rng, n: normal(rng, n) + 1j * normal(rng, n)}, "sample returned complex128.*z.imag"),
        (SAME, {"sample": pairs, "support": lambda x: x >= 0}, r"one boolean a position, shape \(16384,\), not bool"),
        (SAME, {"sample": pairs, "bad_start": 5.0}, r"bad_start=5.0 must be one finite position.*\(16384, 2\)"),
        (SAME, {"sample": normal, "bad_start": np.nan}, "bad_start=nan must be one finite position"),
        (SAME, {"sample": lambda rng, n: {"theta": rng.random(n)}, "bins": UNIT}, "bins= is for positions on the line"),
        (SAME, {"sample": lambda rng, n: rng.random((n, 2)), "bins": UNIT}, "bins= is for positions on the line"),
        (
            SAME,
            {"sample": pairs, "log_density": lambda x: -(x**2) / 2},
            r"one real number, not float64 of shape \(2,\)",
        ),
        (SAME, {"sample": normal, "log_density": np.log}, "log_density.* can not be traced by JAX"),
        (
            JaxKernel(lambda key, p: p, deposits=deposits_without_a_name),
            {"sample": lambda rng, n: {"x": normal(rng, n), "y": normal(rng, n)}},
            r"of D points like the position, \{x: float32\[\], y: float32\[\]\}; the points are float32\[1\]",
        ),
    ],
    ids=[
        "complex",
        "support",
        "bad start",
        "nan",
        "bins of a tree",
        "bins of pairs",
        "log density",
        "numpy",
        "deposits",
    ],
)
def test_what_has_another_shape_is_named(kernel, law, message):
    with pytest.raises(ValueError, match=message):
        verify(kernel, Law(**law), **SIZE)


def test_a_cdf_and_bins_are_not_both_given():
    with pytest.raises(ValueError, match="cdf= or bins=, not both"):
        Law(normal, cdf=ndtr, bins=UNIT)


def test_an_operator_is_of_a_step_that_returns_a_position_alone():
    with pytest.raises(ValueError, match=r"must return the position alone, of shape \(1,\), .*step\(key, x\)\[0\]"):
        step_operator(lambda key, x: (x, None), log_density=lambda x: 0 * x[0], lower=0, upper=1, points=2**10)


ARC = Law(
    lambda rng, n: rng.beta(2, 0.5, (n, 2)),
    cdf=beta(2, 0.5).cdf,
    log_density=lambda x: jnp.sum(jnp.log(x) - 0.5 * jnp.log1p(-x)),
    support=(0, 1),
)


@pytest.mark.parametrize(("b", "verdict"), [(0.5, Verdict.PASS), (0.6, Verdict.FAIL)])
def test_a_float64_position_does_not_round_onto_a_pole_of_the_density(b, verdict):
    """A few draws in 2^14 are 1 in float32, where the density is infinite: the law was to blame."""
    kernel = HostKernel(lambda rng, x: np.where(rng.random((len(x), 1)) < 0.5, rng.beta(2, b, x.shape), x))
    assert verify(kernel, ARC, **SIZE).verdict is verdict


BIT = Law(
    lambda rng, n: rng.integers(2, size=n), statistics={"x": Discrete(lambda x: x, np.full(2, 0.5), ordered=True)}
)


@pytest.mark.parametrize(("stays", "verdict"), [(0.0, Verdict.FAIL), (5e-6, Verdict.INCONCLUSIVE)])
def test_a_kernel_that_seldom_leaves_its_period_is_not_periodic(stays, verdict):
    """After 4096 steps its laws are 0.48 from the right one in turn; that none has left has a probability of e^-14."""
    kernel = HostKernel(lambda rng, x: np.where(rng.random(len(x)) < stays, x, 1 - x))
    report = verify(kernel, BIT, replicas=2**11, gap=0.1)
    assert report.verdict is verdict
    assert "it is periodic" in report.reasons[0]
    assert ("leaves its period too seldom" in report.reasons[0]) == (stays > 0)


def test_a_few_steps_do_not_show_that_a_kernel_is_deterministic(monkeypatch):
    """With time for 65 steps; `test_engine` has the same kernel fail after 16385."""
    monkeypatch.setattr(forgetting, "_SECONDS", 0.0)
    report = verify(HostKernel(lambda rng, x: -x), Law(normal, cdf=ndtr), replicas=2**12, gap=0.1)
    assert report.verdict is Verdict.INCONCLUSIVE
    assert "deterministic, or has not yet met a chance" in report.reasons[0]


class Draws(Kernel):
    """Fresh draws, whose deposits have this weight."""

    weight: jax.Array
    kinds = ("draw",)

    def dim_w(self, target):
        return target.dim_u

    def check(self, target):
        pass

    def step(self, target, state, w):
        after = target.evaluate(State(state.index, w))
        deposits = Deposits(after.seen.x[None], jnp.zeros(1, jnp.int32), self.weight[None])
        return Step(after, deposits, Info(jnp.zeros(1, jnp.int32), jnp.ones(1, w.dtype), jnp.ones(1, bool)))


@pytest.mark.parametrize(("weight", "verdict"), [(1.0, Verdict.PASS), (2.0, Verdict.FAIL), (np.nan, Verdict.FAIL)])
def test_a_kernel_of_the_library_that_deposits_too_much_fails(weight, verdict):
    """It was an error that asked for a larger max_weight, which such a kernel may not be given."""
    report = verify(Draws(jnp.asarray(weight)), Multiplexed(Tabulated([1, 1]), Uniform()), gap=0.1, **SIZE)
    assert report.verdict is verdict
    assert verdict is Verdict.PASS or "the weights of a step's deposits must not be negative" in report.reasons[0]


def test_weights_that_are_no_numbers_are_a_failure_of_any_kernel():
    """In any slice of the replicas; too large a one may be the fault of who gave the bound."""

    def look(weight):
        return Look(np.zeros(1), Picked(np.zeros(1), np.zeros(1, bool), weight, weight))

    sampler = Sampler(Law(normal), HostSubject(SAME), (0,))
    (reason,) = sampler.inspect(np.zeros(2), joined([look(1.0), look(np.nan)]), 1)
    assert "the largest total nan" in reason
    assert not sampler.inspect(np.zeros(2), joined([look(1.0), look(1.0)]), 1)
    with pytest.raises(ValueError, match="give max_weight= their bound"):
        sampler.inspect(np.zeros(2), joined([look(1.0), look(2.0)]), 1)


def test_jax_may_have_another_generator_by_default():
    """Words were made a key of the default generator, which refused them."""
    key, target = key_of((0,)), Multiplexed(Tabulated([1, 1]), Uniform())
    flux = StepFlux(lambda key, x: jax.random.uniform(key, (1,)), lambda x: 0 * x[0], np.zeros(1), np.ones(1))
    with jax.default_prng_impl("rbg"):
        assert np.array_equal(jax.random.key_data(key_of((0,))), jax.random.key_data(key))
        assert 0 < flux(0, jnp.full(1, 0.5), jnp.zeros(2, jnp.uint32)).ends[0].u[0] < 1
        assert multiplexed_law(target).sample(np.random.default_rng(0), 16)["x"].shape == (16,)


@pytest.mark.parametrize("law", [zipf(1.01), poisson(1e11)], ids=["far", "wide"])
def test_a_law_on_integers_without_a_median_is_refused_before_memory_ends(law):
    with pytest.raises(ValueError, match="scipy finds no median of it"):
        verify(SAME, law, **SIZE)


def test_draws_that_float32_has_made_whole_numbers_are_not_taken_for_counts():
    with pytest.raises(LawError, match=r"draws are x = 1e\+06: where that is rounding, verify it with") as error:
        verify(lambda key, x: x, gamma(2.0, loc=1e6, scale=1e-3), **SIZE)
    assert "whole numbers" not in str(error.value)


@pytest.mark.parametrize(("power", "verdict"), [(2.0, Verdict.PASS), (2.1, Verdict.FAIL)])
def test_a_power_law_on_integers_fits_memory(power, verdict):
    """Its quantile at 1 - 1e-12 is 6e11, and there was a cell for every integer up to that."""
    kernel = HostKernel(lambda rng, x: np.where(rng.random(len(x)) < 0.5, rng.zipf(power, len(x)), x))
    assert verify(kernel, zipf(2.0), replicas=2**14, gap=0.1).verdict is verdict


A, B = 3.8e-7, 7.8e-7  # metres
EDGES = np.linspace(A, B, 65)
WAVELENGTHS = {
    "support": {"cdf": lambda x: np.clip((x - A) / (B - A), 0, 1), "support": (A, B)},
    "half": {"cdf": lambda x: np.clip((x - A) / (B - A), 0, 1), "support": (A, np.inf)},
    "bins": {"bins": (EDGES, np.ones(64))},
}


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [(0.25, 0.5, "[0.25, 0.5]"), (1e5, 1e5 + 0.25, "[100000, 100000.25]"), (-np.inf, 1e5 + 0.25, "[-inf, 1e+05]")],
)
def test_cells_far_from_zero_are_told_apart(low, high, said):
    assert interval(low, high) == said


@pytest.mark.parametrize("known", WAVELENGTHS)
@pytest.mark.parametrize(("rate", "verdict"), [(0.0, Verdict.PASS), (0.0015, Verdict.FAIL)])
def test_a_leak_is_seen_on_the_scale_of_the_law(known, rate, verdict):
    """Wavelengths that are negative lay within an absolute 1e-6 of the wall; of the CDF they show 0.0015."""
    law = Law(lambda rng, n: rng.uniform(A, B, n), **WAVELENGTHS[known])

    def step(rng, x):
        y = rng.uniform(A, B, len(x))
        return np.where(rng.random(len(x)) < rate, (y - B) / 4, y)

    assert verify(HostKernel(step), law, replicas=2**15, gap=0.1).verdict is verdict


def test_an_init_that_moves_on_the_scale_of_the_law_is_refused():
    law = Law(lambda rng, n: rng.uniform(A, B, n), support=(A, B))
    for moves in (lambda x: x, lambda x: A + B - x):
        kernel = HostKernel(lambda rng, x: rng.uniform(A, B, len(x)), init=lambda rng, x, moves=moves: moves(x))
        if moves(0.0) == 0.0:
            assert verify(kernel, law, gap=0.1, **SIZE).passed
        else:
            with pytest.raises(ValueError, match="init must keep the position"):
                verify(kernel, law, **SIZE)
