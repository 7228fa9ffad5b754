"""The one accept, deposits, and the runner: reproducible, lossless, indifferent to how the work is divided."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import chain, moves, targets, techniques
from mcmc1d.checks import require_whole
from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.technique import LOPSIDED
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


@pytest.mark.slow
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
