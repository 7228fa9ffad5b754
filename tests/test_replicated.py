"""Replica exchange over techniques: exact on a ring, by the operator, and by `verify` on the line, with its twin."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import verify
from mcmc1d.moves import LargeStep, Mixture, SmallStep
from mcmc1d.moves.exchange import Exchange, ReplicaStep
from mcmc1d.replicated import ReplicaDeposit, Replicated, replicated
from mcmc1d.starts import exact_start
from mcmc1d.subchain import SubChain
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Ramp, Tent

PAIR = mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1, 2.0), (Ramp(1.2), Ramp(-0.8)))
SWAPPING = Mixture({"step": (0.6, ReplicaStep(SmallStep(0.1))), "swap": (0.4, Exchange())})
EDGES = np.linspace(0, 1, 9)


def test_the_masses_are_the_products_of_each_techniques_own():
    masses = Replicated(PAIR, (0, 1)).bin_masses(EDGES)
    u = (np.arange(4096) + 0.5) / 4096
    rows = []
    for i in (0, 1):
        with jax.enable_x64(True):
            states = jax.vmap(lambda u, i=i: PAIR.evaluate(mcmc1d.State(jnp.asarray(i), u[None])).seen.log_c)(u)
        rows.append(np.exp(np.asarray(states)).reshape(8, -1).mean(1) / 8)
    assert np.allclose(masses, np.outer(*rows), rtol=1e-5)
    assert np.allclose(Replicated(PAIR, (1,)).bin_masses(EDGES), rows[1], rtol=1e-5)


@pytest.mark.parametrize("move", [SWAPPING, Mixture({"step": (1.0, ReplicaStep(LargeStep()))})])
def test_steps_and_swaps_keep_the_product(move):
    """Both replicas by the operator; a swap whose ratio is left out would be off by 0.1."""
    target = replicated(PAIR)
    law = verify.transition_operator(move, target, points=2**17).law_of(EDGES, lambda u: u[..., 0]).masses[0]
    exact = Replicated(PAIR, (0, 1)).bin_masses(EDGES).sum(1)
    assert np.abs(law - exact / exact.sum()).sum() / 2 < 2e-3


@pytest.mark.slow
def test_its_deposits_are_samples_of_f():
    """In c_i / b parts; in other parts they are caught. The chain: level 1e-5, a CDF gap of 0.05 found in 99 of 100."""
    c = np.array([Replicated(PAIR, (i,)).bin_masses(EDGES).sum() for i in (0, 1)])
    options = {"replicas": 2**14, "reversible": False, "steps": (1, 4, 16)}
    shares = c / c.sum()
    edges = np.linspace(0, 1, 21)
    exact = PAIR.target.bin_masses(edges)
    start = [exact_start(jax.random.key(i), PAIR, 2**12, index=i).u for i in (0, 1)]
    first = mcmc1d.State(jnp.zeros(2**12, jnp.int32), jnp.concatenate(start, 1))
    off = {}
    for name, parts in {"right": shares, "lopsided": np.array([0.8, 0.2])}.items():
        kernel = ReplicaDeposit(SWAPPING, parts)
        size = {"steps": 64, "chains": 2**12, "blocks": 16, "start": first}
        estimators = {"x": mcmc1d.Expectation(lambda x: jax.nn.one_hot((20 * jnp.ravel(x)[0]).astype(int), 20))}
        run = mcmc1d.run(jax.random.key(3), kernel, replicated(PAIR), **size, estimators=estimators)
        off[name] = np.abs((run.mean("x") - exact / exact.sum()) / run.standard_error("x")).max()
    assert off["right"] < 7 < off["lopsided"]  # t with 15 degrees of freedom, 20 bins: by chance in 1e-4 of the runs
    assert verify.verify(SWAPPING, replicated(PAIR), **options).passed


@pytest.fixture(scope="module")
def shares():
    """Of the two techniques in f."""
    return PAIR.joint_masses([0.0, 1.0])[:, 0]


OPTIONS = {"replicas": 2**14, "reversible": False, "steps": (1, 4, 16)}


class Claimed(ReplicaDeposit):
    """Says that its shares are those of the techniques, whatever they are."""

    def _in_proportion(self, own, given):
        return True


@pytest.mark.slow
def test_verify_holds_its_deposits_to_f(shares):
    """Level 1e-5. Of wrong shares, 0.8 and 0.2 for 0.48 and 0.52, the deposits are caught, and nothing else."""
    assert verify.verify(ReplicaDeposit(SWAPPING, shares), replicated(PAIR), **OPTIONS).passed
    wrong = verify.verify(Claimed(SWAPPING, np.array([0.8, 0.2])), replicated(PAIR), **OPTIONS)
    assert {failure.layer for failure in wrong.failures} == {"deposits"}


def test_of_other_shares_no_law_is_promised():
    """They failed, though who wants samples of each technique makes no mistake; now the deposits are not looked at."""
    report = verify.verify(ReplicaDeposit(SWAPPING, np.array([0.8, 0.2])), replicated(PAIR), **OPTIONS)
    assert report.verdict.value == "INCONCLUSIVE"
    assert not report.failures
    assert any("deposits are of another law" in reason for reason in report.reasons)


def test_which_shares_are_known_to_be_right(shares):
    """In any unit and in float32; not where they are off by 1e-5, nor where a technique has no replica."""

    def promised(given, techniques=None):
        return ReplicaDeposit(SWAPPING, given).deposited(replicated(PAIR, techniques))

    for right in (shares, 3 * shares, jnp.asarray(shares, jnp.float32)):
        assert promised(right).target is PAIR
        assert promised(right).total == promised(right).most == pytest.approx(np.sum(right))
    for wrong in (shares + np.array([1e-5, -1e-5]), np.ones(2), np.zeros(2)):
        assert promised(wrong).target is None
    assert promised(np.ones(1), (1,)).target is None


def test_a_cycle_and_a_sub_chain_say_what_they_deposit(shares):
    kernel = ReplicaDeposit(SWAPPING, shares)
    assert mcmc1d.Cycle([kernel, kernel]).deposited(replicated(PAIR)).target is PAIR
    assert SubChain(SWAPPING, kernel, 2).deposited(replicated(PAIR)).target is PAIR
    assert mcmc1d.Cycle([SWAPPING, SWAPPING]).deposited(replicated(PAIR)) is None
    with pytest.raises(ValueError, match="deposit samples of different things"):
        mcmc1d.Cycle([kernel, SWAPPING]).deposited(replicated(PAIR))


def test_what_is_no_replica_is_refused():
    with pytest.raises(ValueError, match="different ones of 0 to 1"):
        Replicated(PAIR, (0, 0))
    with pytest.raises(ValueError, match="must hold 2 replicas of 1 numbers"):
        Exchange().check(mcmc1d.Multiplexed(Sinusoid(), Tent()))
    with pytest.raises(ValueError, match="2 replicas have as many shares, none negative"):
        ReplicaDeposit(SWAPPING, np.ones(3)).check(replicated(PAIR))
