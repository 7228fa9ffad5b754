"""What runs add up: in which precision, of which deposits, and by estimators of a user's own."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import moves, targets, techniques
from mcmc1d.estimators import add_deposits
from mcmc1d.metropolis import Deposits
from mcmc1d.pooled import PooledDeposit, pooled


def test_no_count_is_lost_beyond_what_a_float32_can_hold():
    """Plain deposits of 2**25 steps in one bin: a float32 sum would stop at 2**24."""
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Uniform())
    kernel = mcmc1d.Metropolis(moves.LargeStep(), deposit="plain")
    estimators = {"h": mcmc1d.Histogram(1)}
    run = mcmc1d.run(jax.random.key(0), kernel, target, steps=4096, chains=8192, blocks=1, estimators=estimators)
    assert run.sums["h"].sum() == 2**25


def in_bins(bins, places, weight):
    """What 8192 chains leave that deposit `weight`, (deposits, chains) in float32, at these places."""
    with jax.enable_x64(True):
        x = jnp.broadcast_to(jnp.asarray(places, jnp.float32)[:, None], weight.shape)
        one = jax.vmap(lambda x, w: Deposits(x, jnp.zeros(w.shape, jnp.int32), w), -1, -1)
        deposits = one(x, jnp.asarray(weight, jnp.float32))
        zero = jnp.zeros(bins, jnp.float64)
        return np.asarray(add_deposits(zero, deposits, lambda x: (bins * x).astype(int), joint=False))


@pytest.mark.parametrize("small", [1e-12, 1e-6, 0.3])
def test_thousands_of_deposits_are_not_rounded_alike(small):
    """In float32 a bin's sum loses a small deposit beside large ones, and rounds equal ones to the same side."""
    weight = np.broadcast_to(np.array([1 - small, small], np.float32)[:, None], (2, 8192))
    exact = 8192 * weight[:, 0].astype(np.float64)
    assert in_bins(2, [0.25, 0.75], weight) == pytest.approx(exact, rel=1e-11)
    assert in_bins(1, [0.25, 0.75], weight) == pytest.approx(exact.sum(), rel=1e-11)


def test_sums_are_float64_whatever_the_chains_are():
    """2**22 times a third, by a user's estimator and by the library's, in float32 chains; and that it is accepted."""

    class Third(moves.LargeStep):
        """A large step that is accepted with probability 1/3."""

        def propose(self, target, state, w):
            proposal = super().propose(target, state, w)
            return eqx.tree_at(lambda p: p.log_det, proposal, jnp.log(jnp.float32(1) / 3))

    class Thirds(mcmc1d.estimators.Estimator):
        def init(self, target, kernel, dtype):
            return jnp.zeros(2)

        def update(self, sums, steps):
            return sums.at[0].add((steps.deposits.weight / 3).sum(0)[0] * steps.deposits.x.shape[-1])

    third = np.float64(np.float32(1) / np.float32(3))
    target = mcmc1d.Multiplexed(targets.FromFunction(lambda x: 1 + 0 * x), techniques.Uniform())
    kernel = mcmc1d.Metropolis(Third(), deposit="plain")
    estimators = {"own": Thirds(), "expectation": mcmc1d.Expectation(lambda x: jnp.float32(1) / 3)}
    estimators["acceptance"] = mcmc1d.Acceptance()
    run = mcmc1d.run(
        jax.random.key(0), kernel, target, steps=4096, chains=1024, blocks=1, estimators=estimators, dtype=jnp.float32
    )
    assert run.sums["expectation"].dtype == run.sums["own"].dtype == np.float64
    assert run.mean("expectation") == pytest.approx(third, rel=1e-13)
    assert run.mean("own")[0] == pytest.approx(third, rel=1e-13)
    once = np.asarray(jnp.exp(jnp.log(jnp.float32(1) / 3)), np.float64)
    assert run.acceptance()["Third"] == pytest.approx(once, rel=1e-13)


TABLE = np.linspace(0, 1, 3)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: jax.lax.fori_loop(0, 3, lambda i, c: c + x, jnp.float32(0)),
        lambda x: jax.lax.cond(x > 0.5, lambda: x, lambda: jnp.float32(0)),
        lambda x: jax.lax.select(x > 0.5, x, jnp.zeros((), jnp.float32)),
        lambda x: jax.lax.scan(lambda c, y: (c + y * x, None), x, TABLE)[0],
    ],
)
def test_what_an_expectation_is_of_is_traced_as_the_chains_are(function):
    """Where a loop's carry, or both branches, must be of one type: float32 like x, not what sums are kept in."""
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Uniform())
    estimators = {"own": mcmc1d.Expectation(function), "complex": mcmc1d.Expectation(lambda x: jnp.exp(1j * x))}
    run = mcmc1d.run(
        jax.random.key(0), moves.LargeStep(), target, steps=8, chains=64, estimators=estimators, dtype=jnp.float32
    )
    assert run.sums["own"].dtype == np.float64
    assert np.iscomplex(run.mean("complex"))


class _Counts(mcmc1d.estimators.Estimator):
    """Steps as whole numbers, past what 32 bits hold; or, wrongly, fractions of them."""

    share: float = eqx.field(static=True, default=1.0)

    def init(self, target, kernel, dtype):
        return jnp.zeros((), jnp.int32)

    def update(self, sums, steps):
        return sums + (2**30 if self.share == 1 else self.share)


def test_counts_are_whole_and_long():
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Uniform())
    run = mcmc1d.run(
        jax.random.key(0), moves.LargeStep(), target, steps=16, chains=8, blocks=1, estimators={"n": _Counts()}
    )
    assert run.sums["n"].sum() == 16 * 2**30
    with pytest.raises(ValueError, match=r"_Counts.update returned float\d\d for a sum that init made int64"):
        mcmc1d.run(jax.random.key(0), moves.LargeStep(), target, steps=1, chains=8, estimators={"n": _Counts(0.5)})


def test_heavy_and_light_deposits_are_added_and_nan_stays():
    for weight in (4.0, 1e9, 0.0, 1e-32):
        each = np.full((1, 8192), weight, np.float32)
        assert in_bins(2, [0.25], each).tolist() == [8192 * float(each[0, 0]), 0]
    assert np.isnan(in_bins(2, [0.25], np.full((1, 8192), np.nan))[0])


def test_hundreds_of_deposits_a_step_are_added_as_few_are():
    """A loop from nine on; of both, more than their sum is compared."""
    rng = np.random.default_rng(0)
    x, weight = rng.random((40, 512)).astype(np.float32), rng.dirichlet(np.ones(40), 512).T.astype(np.float32)
    many = jax.vmap(lambda x, w: Deposits(x, jnp.zeros(40, int), w), -1, -1)(x, weight)
    exact = np.histogram(x, 8, (0, 1), weights=weight.astype(np.float64))[0]
    found = add_deposits(jnp.zeros(8), many, lambda x: (8 * x).astype(int), joint=False)
    assert np.allclose(found, exact, atol=40 * 2**-20)
    parts = [
        add_deposits(
            jnp.zeros(8), jax.tree.map(lambda a, k=k: a[k : k + 8], many), lambda x: (8 * x).astype(int), joint=False
        )
        for k in range(0, 40, 8)
    ]
    assert np.allclose(sum(parts), exact, atol=40 * 2**-20)


def test_an_edge_that_rounds_in_float32_still_covers():
    target = mcmc1d.Multiplexed(
        targets.FromFunction(lambda x: 1 + x, 0.1, 0.9), techniques.PiecewiseConstant([0.1, 0.9], [1])
    )
    bins = mcmc1d.Histogram(8, domain=(0.1, 0.9))
    run = mcmc1d.run(jax.random.key(0), moves.LargeStep(), target, steps=2, chains=8, estimators={"x": bins})
    assert run.sums["x"].sum() == pytest.approx(16)


def test_expectations_of_several_things_are_a_tree():
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Uniform())
    both = mcmc1d.Expectation(lambda x: {"one": jnp.ones(()), "two": jnp.stack([x, 2 * x])})
    run = mcmc1d.run(jax.random.key(0), moves.LargeStep(), target, steps=4, chains=64, estimators={"e": both})
    mean = run.mean("e")
    assert mean["one"] == pytest.approx(1)
    assert mean["two"][1] == pytest.approx(2 * mean["two"][0])


def test_an_expectation_of_a_plain_number_counts_the_steps():
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Uniform())
    estimators = {"one": mcmc1d.Expectation(lambda x: 1.0)}
    run = mcmc1d.run(jax.random.key(0), moves.SmallStep(), target, steps=20, chains=64, estimators=estimators)
    assert run.mean("one") == pytest.approx(1, abs=1e-6)


# --- what is deposited is not always the chain's own target ---------------------------------------------------------


def wide():
    """A flat f on [-1, 2], by two techniques: what deposits its samples walks on a cube, which is another domain."""
    f = targets.FromFunction(lambda x: 1.0 + 0 * x, -1.0, 2.0)
    flat, steep = techniques.PiecewiseConstant([-1, 2], [1]), techniques.PiecewiseConstant([-1, 0, 2], [3, 1])
    return mcmc1d.Multiplexed(f, (flat, steep))


def test_sums_are_of_what_is_deposited():
    """By PSSMLT on [-1, 2]: bins of that domain, jointly with the technique; those of the cube are refused."""
    own, kernel = wide(), PooledDeposit(moves.LargeStep())
    edges = np.linspace(-1, 2, 7)
    estimators = {"law": mcmc1d.Histogram(edges), "joint": mcmc1d.Histogram(edges, joint=True)}
    run = mcmc1d.run(jax.random.key(0), kernel, pooled(own), steps=256, chains=2**12, estimators=estimators)
    for name, exact in (("law", np.full(6, 1 / 6)), ("joint", own.joint_masses(edges))):
        error = run.standard_error(name)
        assert np.all(np.abs(run.mean(name) - exact) < 15 * error + 1e-6)  # of 8 blocks: 1e-6 each
    with pytest.raises(ValueError, match=r"Histogram: .*\[-1"):
        mcmc1d.run(jax.random.key(0), kernel, pooled(own), steps=1, estimators={"h": mcmc1d.Histogram(6)})


@pytest.mark.slow
def test_a_cycle_of_kernels_that_deposit_different_things_has_no_sums():
    """PSSMLT's small step deposits samples of f; the large step beside it, a plain one, deposits u."""
    mixed = mcmc1d.Cycle([PooledDeposit(moves.SmallStep(0.1)), moves.LargeStep()])
    with pytest.raises(ValueError, match="Cycle: its kernels deposit samples of different things"):
        mcmc1d.run(jax.random.key(0), mixed, pooled(wide()), steps=1, estimators={"h": mcmc1d.Histogram(6)})
    mcmc1d.run(jax.random.key(0), mixed, pooled(wide()), steps=1, estimators={"a": mcmc1d.Acceptance()})
    both = mcmc1d.Cycle([PooledDeposit(moves.SmallStep(0.1)), PooledDeposit(moves.LargeStep())])
    mcmc1d.run(jax.random.key(0), both, pooled(wide()), steps=1, estimators={"h": mcmc1d.Histogram([-1, 2])})
