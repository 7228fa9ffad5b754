"""The one accept, deposits, and the runner: reproducible, lossless, indifferent to how the work is divided."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import chain, moves, targets, techniques
from mcmc1d.checks import require_whole
from mcmc1d.estimators import add_deposits
from mcmc1d.metropolis import Deposits
from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.technique import LOPSIDED
from mcmc1d.pooled import PooledDeposit, pooled
from mcmc1d.verify.goodness import p_value, smallest_gap
from mcmc1d.verify.mutants.jumps import no_jacobian

EDGES = np.linspace(0, 1, 41)


def hard():
    return mcmc1d.verify.hard_target()


class _ToNowhere(Move):
    """Proposes u = NaN for half of its numbers, and a place outside the cube for the rest."""

    def dim_w(self, target):
        return 1

    def propose(self, target, state, w):
        u = jnp.where(w[0] < 0.5, jnp.nan, 1.5) * jnp.ones_like(state.u)
        return Proposal(mcmc1d.State(state.index, u), w, jnp.zeros((), u.dtype))


def one_step(move, target, n=64):
    kernel = mcmc1d.Metropolis(move)
    state = jax.vmap(target.evaluate)(mcmc1d.exact_start(jax.random.key(1), target, n))
    w = jax.random.uniform(jax.random.key(2), (n, kernel.dim_w(target)))
    return state, jax.vmap(lambda s, w: kernel.step(target, s, w))(state, w)


def test_an_impossible_proposal_is_rejected_and_leaves_no_nan():
    state, step = one_step(_ToNowhere(), hard())
    assert not step.info.accepted.any()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(step.deposits))
    assert jax.tree.all(jax.tree.map(np.array_equal, step.state, state))


@pytest.mark.parametrize("move", [moves.SmallStep(0.3), moves.AimedJump(), moves.TechniqueChange(LOPSIDED)])
def test_deposits_of_a_step_weigh_one(move):
    _, step = one_step(move, hard())
    assert np.allclose(step.deposits.weight.sum(1), 1, atol=1e-6)


def test_the_state_remembers_what_an_evaluation_finds():
    """After steps of every kind the cached evaluation is a fresh one's, to the rounding of float64 through a jump."""
    with jax.enable_x64(True):
        target, kinds = hard(), {"small": (0.4, moves.SmallStep(0.1)), "jump": (0.6, moves.ReversibleJump(LOPSIDED))}
        kernel = mcmc1d.Metropolis(moves.Mixture(kinds))
        state = jax.vmap(target.evaluate)(mcmc1d.exact_start(jax.random.key(3), target, 500))
        step = jax.jit(jax.vmap(lambda s, w: kernel.step(target, s, w)))
        for k in range(20):
            w = jax.random.uniform(jax.random.fold_in(jax.random.key(4), k), (500, kernel.dim_w(target)))
            state = step(state, w).state
        fresh = jax.vmap(target.evaluate)(mcmc1d.State(state.index, state.u))
        for kept, found in zip(jax.tree.leaves(state.eval), jax.tree.leaves(fresh.eval), strict=True):
            both = np.isfinite(kept) & np.isfinite(found)
            assert np.abs(kept - found)[both].max() < 1e-6
            assert both.mean() > 0.5


def short_run(seed=0, move=moves.AimedJump(), **changes):  # noqa: B008
    arguments = {
        "steps": 40,
        "chains": 256,
        "blocks": 4,
        "estimators": {"h": mcmc1d.Histogram(20, joint=True)},
        **changes,
    }
    return mcmc1d.run(jax.random.key(seed), move, hard(), **arguments)


def test_same_key_same_numbers_another_key_others():
    assert np.array_equal(short_run().sums["h"], short_run().sums["h"])
    assert not np.array_equal(short_run().sums["h"], short_run(1).sums["h"])


def test_numbers_do_not_depend_on_workers_or_on_pieces(monkeypatch):
    """Exactly, for a move that hands on no evaluation: after each piece the state is evaluated afresh."""
    whole = short_run(move=moves.SmallStep())
    monkeypatch.setattr(chain.os, "sched_getaffinity", lambda _: {0}, raising=False)
    monkeypatch.setattr(chain, "_STEPS_PER_LOOK", 7)
    pieces = short_run(move=moves.SmallStep())
    assert np.array_equal(whole.state.u, pieces.state.u)
    assert np.allclose(whole.sums["h"], pieces.sums["h"], rtol=1e-12)


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
    """2**22 times a third, by a user's estimator and by the library's, in float32 chains."""

    class Thirds(mcmc1d.estimators.Estimator):
        def init(self, target, kernel, dtype):
            return jnp.zeros(2)

        def update(self, sums, steps):
            return sums.at[0].add((steps.deposits.weight / 3).sum(0)[0] * steps.deposits.x.shape[-1])

    third = np.float64(np.float32(1) / np.float32(3))
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Uniform())
    kernel = mcmc1d.Metropolis(moves.LargeStep(), deposit="plain")
    estimators = {"own": Thirds(), "expectation": mcmc1d.Expectation(lambda x: jnp.float32(1) / 3)}
    run = mcmc1d.run(
        jax.random.key(0), kernel, target, steps=4096, chains=1024, blocks=1, estimators=estimators, dtype=jnp.float32
    )
    assert run.sums["expectation"].dtype == run.sums["own"].dtype == np.float64
    assert run.mean("expectation") == pytest.approx(third, rel=1e-6)  # a step's 1024 are summed in float32
    assert run.mean("own")[0] == pytest.approx(third, rel=1e-13)


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


def test_expectation_and_cycle():
    """Mean of x under f = 2 x is 2/3; 8 blocks give its error, and 6 of them a false alarm of 5e-4 at another seed."""
    target = mcmc1d.Multiplexed(targets.PiecewiseLinear([0, 1], [0, 2]), techniques.Uniform())
    cycle = mcmc1d.Cycle([mcmc1d.Metropolis(moves.LargeStep()), mcmc1d.Metropolis(moves.SmallStep(0.1))])
    estimators = {"x": mcmc1d.Expectation(lambda x: x), "acceptance": mcmc1d.Acceptance()}
    run = mcmc1d.run(jax.random.key(0), cycle, target, steps=200, chains=1024, estimators=estimators)
    assert abs(run.mean("x") - 2 / 3) < 6 * run.standard_error("x")
    assert run.standard_error("x") < 2e-3
    assert set(run.acceptance()) == {"LargeStep", "SmallStep"}


def test_a_cycle_wraps_moves_and_tells_equal_kinds_apart():
    cycle = mcmc1d.Cycle([moves.SmallStep(0.01), mcmc1d.Metropolis(moves.LargeStep()), moves.SmallStep(0.5)])
    assert cycle.kinds == ("SmallStep", "LargeStep", "SmallStep 2")
    rates = short_run(move=cycle, estimators={"acceptance": mcmc1d.Acceptance()}).acceptance()
    assert rates["SmallStep"] > rates["SmallStep 2"]


@pytest.mark.parametrize(("chains", "blocks"), [(1, 1), (2, 2), (7, 7), (9, 3), (8192, 8)])
def test_blocks_divide_the_chains_unless_given(chains, blocks):
    estimators = {"h": mcmc1d.Histogram(np.int64(4))}
    run = mcmc1d.run(jax.random.key(0), moves.SmallStep(), hard(), steps=1, chains=chains, estimators=estimators)
    assert run.sums["h"].shape == (blocks, 4)


def test_trace_keeps_every_state():
    trace = mcmc1d.trace(jax.random.key(0), moves.SmallStep(), hard(), steps=5, chains=3)
    assert trace.x.shape == trace.index.shape == (5, 3)


def test_trace_starts_where_it_is_told():
    start = mcmc1d.State(np.array([2, 0]), np.array([[0.5, 0.25], [1 - 1e-12, 0]]))  # rounds to 1 in float32
    trace = mcmc1d.trace(jax.random.key(0), moves.SmallStep(1e-6), hard(), steps=1, chains=2, start=start)
    assert trace.index.tolist() == [[2, 0]]
    assert np.isclose(trace.x[0, 0], hard().forward(2, jnp.asarray(start.u[0]))[0], atol=1e-4)
    assert np.isfinite(trace.x).all()


@pytest.mark.parametrize("do", [mcmc1d.run, mcmc1d.trace])
@pytest.mark.parametrize(
    ("index", "u", "message"),
    [
        (np.zeros(3, np.int32), np.zeros((3, 2)), r"start.u must be of shape \(2, 2\), not \(3, 2\)"),
        (np.zeros(3, np.int32), np.zeros((2, 2)), r"start.index must be of shape \(2,\)"),
        (np.array([0, 3]), np.zeros((2, 2)), r"start.index must lie in 0..2 and .* chain 1 has 3"),
        (np.array([0, -1]), np.zeros((2, 2)), "chain 1 has -1"),
        (np.array([0, 1]), np.array([[0, 0], [1.0, 0]]), r"start.u in \[0, 1\); chain 1"),
        (np.array([0, 1]), np.array([[0, np.nan], [0, 0]]), "chain 0 has 0"),
    ],
)
def test_a_start_that_is_none_is_refused(do, index, u, message):
    with pytest.raises(ValueError, match=message):
        do(jax.random.key(0), moves.SmallStep(), hard(), steps=1, chains=2, start=mcmc1d.State(index, u))


def test_normalisation_is_the_integral_of_f():
    """Within 6 of its standard errors: a false alarm has probability 2e-9; it detects 1 % of b."""
    target = mcmc1d.Multiplexed(targets.Sinusoid(0.9, 2.0, 0.0, 3.5), hard().techniques)
    b = mcmc1d.normalisation(jax.random.key(0), target)
    assert abs(b.value - 3.5) < 6 * b.standard_error < 0.035


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"chains": 10}, "can not be dealt into 4 equal blocks"),
        ({"steps": 0}, "steps must be a whole number, 1 at least"),
        ({"estimators": {"h": mcmc1d.Histogram([0, 0.5])}}, "do not cover the domain"),
    ],
)
def test_a_run_that_can_not_be_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        short_run(**changes)


def test_a_proposal_matrix_must_fit_the_techniques():
    with pytest.raises(ValueError, match="must be 3 x 3"):
        mcmc1d.run(jax.random.key(0), moves.ReversibleJump([[1.0]]), hard(), steps=1, chains=8)


N, LEVEL = 2**16, 1e-6


def law_after_16_steps(move):
    """The p-value of (technique, x) after 16 steps of 2**16 chains that start exactly from the target."""
    target = hard()
    run = mcmc1d.run(jax.random.key(7), move, target, steps=16, chains=N)
    x = np.asarray(jax.vmap(target.evaluate)(run.state).seen.x)
    cells = np.zeros((3, 40))
    np.add.at(cells, (np.asarray(run.state.index), np.clip(np.searchsorted(EDGES, x, side="right") - 1, 0, 39)), 1)
    return p_value(cells, target.joint_masses(EDGES))


def with_small_steps(jump):
    return moves.Mixture({"small": (0.5, moves.SmallStep(0.1)), "jump": (0.5, jump)})


@pytest.mark.parametrize(
    "move",
    [
        with_small_steps(moves.TechniqueChange(LOPSIDED)),
        with_small_steps(moves.ReversibleJump(LOPSIDED)),
        with_small_steps(moves.AimedJump()),
        moves.ExponentialStep(),
        moves.StepAndChange(moves.LargeStep()),
    ],
    ids=["change", "jump", "aimed", "exponential", "large"],
)
def test_right_moves_keep_the_exact_law(move):
    """False alarm 1e-6 each; detects a CDF gap of 0.017 with probability 0.99."""
    assert smallest_gap(N, LEVEL) < 0.018
    assert law_after_16_steps(move) > LEVEL


@pytest.mark.parametrize(
    "wrong", [no_jacobian(moves.ReversibleJump(LOPSIDED)), no_jacobian(moves.TechniqueChange(LOPSIDED))]
)
def test_their_twins_without_the_determinant_do_not(wrong):
    assert law_after_16_steps(with_small_steps(wrong)) < LEVEL


def test_numbers_of_numpy_are_whole_too():
    """A checkpoint's head holds them: it could not be written, when the run was done."""
    assert type(require_whole(np.int64(20), "a run's steps")) is int


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


def test_a_cycle_of_kernels_that_deposit_different_things_has_no_sums():
    """PSSMLT's small step deposits samples of f; the large step beside it, a plain one, deposits u."""
    mixed = mcmc1d.Cycle([PooledDeposit(moves.SmallStep(0.1)), moves.LargeStep()])
    with pytest.raises(ValueError, match="Cycle: its kernels deposit samples of different things"):
        mcmc1d.run(jax.random.key(0), mixed, pooled(wide()), steps=1, estimators={"h": mcmc1d.Histogram(6)})
    mcmc1d.run(jax.random.key(0), mixed, pooled(wide()), steps=1, estimators={"a": mcmc1d.Acceptance()})
    both = mcmc1d.Cycle([PooledDeposit(moves.SmallStep(0.1)), PooledDeposit(moves.LargeStep())])
    mcmc1d.run(jax.random.key(0), both, pooled(wide()), steps=1, estimators={"h": mcmc1d.Histogram([-1, 2])})
