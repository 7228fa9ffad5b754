"""Ladders, replicas, pooled and floored techniques: exact on rings and by operators, statistically on the line."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import tempering, weights
from mcmc1d.metropolis import OfMove
from mcmc1d.moves import LargeStep, Mixture, SmallStep, StepAndChange, TechniqueChange
from mcmc1d.moves.exchange import CoordinateStep, Exchange, ReplicaStep
from mcmc1d.pooled import Floored, Pooled, PooledDeposit, floored, integral, pooled, samples
from mcmc1d.targets import Banana, FromFunction, Sinusoid, Tabulated
from mcmc1d.targets.planar import two_ridges
from mcmc1d.targets.tempered import Sum, Tempered
from mcmc1d.techniques import Inversion, Ramp, Rectangle, Tent, Uniform
from mcmc1d.techniques.product import Product
from mcmc1d.verify import RingStep, deposit_law, enumerate_kernel, ring, transition_operator, verify

SINUSOID = Sinusoid(0.9, 1.5, 0.1, 3.0)
EDGES = np.linspace(0, 1, 9)
PAIR = mcmc1d.Multiplexed(SINUSOID, (Tent(0.3), Ramp(1.2)))


def exact(edges=EDGES):
    masses = SINUSOID.bin_masses(edges)
    return masses / masses.sum()


# --- ladders --------------------------------------------------------------------------------------------------------


def test_on_its_own_rung_the_target_has_its_law_whatever_the_prior():
    betas = [0.0, 0.3, 1.0]
    for log_prior in (None, [0, 0, 0], [2.0, -1.0, -3.0]):
        row = tempering.ladder(SINUSOID, betas, log_prior=log_prior).joint_masses(EDGES)[2]
        assert np.allclose(row / row.sum(), exact(), atol=1e-10)
    even = tempering.ladder(SINUSOID, betas).joint_masses(EDGES).sum(1)
    assert np.allclose(even, 1 / 3, atol=1e-10)


def test_a_ladder_is_exact_on_a_ring():
    """Two rungs, a step of u and a change of rung in turn: the states' law is kept to the last bits."""
    f = np.array([1, 3, 0.5, 2])
    _, states = ring(f, (Uniform(), Uniform()))
    target = tempering.ladder(Tabulated(f), [1.0, 0.4], log_prior=[0.3, -0.2])
    kernel = mcmc1d.Cycle([RingStep(4, {1: 0.5, -1: 0.25, 2: 0.25}), TechniqueChange([[0.2, 0.8], [0.5, 0.5]])])
    found = enumerate_kernel(kernel, target, states)
    assert found.residual < 1e-12
    law = np.exp(0.3) * f, np.exp(-0.2) * f**0.4
    assert np.allclose(found.law, np.concatenate(law) / np.sum(law), atol=1e-12)


STEP = StepAndChange(SmallStep(0.2))


def test_a_ladder_is_verified():
    """At level 1e-5; 2^14 replicas show a CDF gap of 0.035 with probability 0.99."""
    target = tempering.ladder(SINUSOID, [0.1, 1.0], Ramp(0.5), [0.5, 0.0])
    assert verify(STEP, target, replicas=2**14).passed


class _DropsTheDensity(mcmc1d.weights.Weights):
    """A rung's weight without the change of f that goes with it: the prior alone."""

    def log_weights(self, x, log_p):
        return [jnp.log(jnp.asarray(share)) + 0 * x for share in (0.6, 0.4)]


def test_a_rung_change_by_the_prior_alone_is_caught():
    """The twin: accepted by the prior alone, the chain's law is not the ladder's."""
    target = tempering.ladder(SINUSOID, [0.1, 1.0], Ramp(0.5), [0.5, 0.0])
    wrong = mcmc1d.Multiplexed(target.target, target.techniques, _DropsTheDensity())

    class Wrong(mcmc1d.Kernel):
        kinds = ("Wrong",)

        def dim_w(self, target):
            return STEP.dim_w(target) + 1

        def check(self, target):
            pass

        def step(self, target, state, w):
            stepped = mcmc1d.Metropolis(STEP).step(wrong, wrong.evaluate(mcmc1d.State(state.index, state.u)), w)
            after = target.evaluate(mcmc1d.State(stepped.state.index, stepped.state.u))
            return mcmc1d.metropolis.Step(after, stepped.deposits, stepped.info)

    assert verify(Wrong(), target, replicas=2**14, reversible=False).failures


# --- replicas -------------------------------------------------------------------------------------------------------


def exchange(weight=0.3):
    return Mixture({"step": (1 - weight, CoordinateStep(0.2)), "swap": (weight, Exchange())})


def test_replicas_keep_their_product_law():
    target = tempering.replicas(SINUSOID, [1.0, 0.2])
    operator = transition_operator(exchange(), target, points=2**16)
    law = operator.law_of(EDGES, lambda x: x[..., 0])
    assert np.abs(law.masses[0] - exact()).sum() / 2 < 3 * law.noise
    assert verify(exchange(), target, replicas=2**13).passed


class _AlwaysSwaps(mcmc1d.Kernel):
    """The mistake: swaps without looking at the temperatures."""

    kinds = ("swap",)

    def dim_w(self, target):
        return 1

    def check(self, target):
        pass

    def step(self, target, state, w):
        after = target.evaluate(mcmc1d.State(state.index, state.u.reshape(2, -1)[::-1].ravel()))
        plain = mcmc1d.Metropolis(Exchange(), "plain").step(target, state, jnp.stack([w[0], w[0]]))
        deposits = mcmc1d.metropolis.Deposits(after.seen.x[None], plain.deposits.index, plain.deposits.weight)
        return mcmc1d.metropolis.Step(after, deposits, plain.info)


def test_a_swap_that_is_always_made_is_caught():
    target = tempering.replicas(SINUSOID, [1.0, 0.2])
    report = verify(mcmc1d.Cycle([exchange(), _AlwaysSwaps()]), target, replicas=2**15)
    assert report.failures


def test_masses_of_replicas_are_products():
    masses = tempering.Replicas(SINUSOID, [1.0, 0.5]).bin_masses(EDGES)
    rows = [Tempered(SINUSOID, b).bin_masses(EDGES) for b in (1.0, 0.5)]
    assert np.allclose(masses, np.outer(*rows), rtol=1e-10)


@pytest.mark.slow
def test_replicas_in_the_plane_are_points_end_to_end():
    f, x = two_ridges(), np.array([0.3, 0.4, 0.7, 0.2])
    pair = tempering.replicas(f, [1.0, 0.5], Rectangle())
    log_f = [float(f.log_f(jnp.asarray(part))) for part in (x[:2], x[2:])]
    assert float(pair.target.log_f(jnp.asarray(x))) == pytest.approx(log_f[0] + 0.5 * log_f[1], rel=1e-5)
    edges = np.linspace(0, 1, 3)
    rows = [Tempered(f, b).bin_masses((edges, edges)) for b in (1.0, 0.5)]
    assert np.allclose(pair.target.bin_masses(edges), np.multiply.outer(*rows), rtol=1e-9)
    swap = Mixture({"step": (0.7, ReplicaStep(SmallStep(0.2), 2)), "swap": (0.3, Exchange(2))})
    assert verify(swap, pair, replicas=2**15).passed


@pytest.mark.slow
@pytest.mark.parametrize(("other", "wrong"), [(0.1, True), (1.0, False)])
def test_a_swap_in_the_plane_that_is_always_made_is_caught(other, wrong):
    """Between replicas at one temperature it is right. At level 1e-5."""
    pair = tempering.replicas(two_ridges(), [1.0, other], Rectangle())
    walk = ReplicaStep(SmallStep(0.2), 2)
    assert bool(verify(mcmc1d.Cycle([walk, _AlwaysSwaps()]), pair, replicas=2**15).failures) == wrong


def test_the_rungs_of_a_planar_ladder_are_equally_likely():
    f = Banana()  # of sides that differ
    ladder = tempering.ladder(f, [1.0, 0.3, 0.0], Rectangle(f.lower, f.upper))
    edges = [np.linspace(a, b, 3) for a, b in zip(f.lower, f.upper, strict=True)]
    shares = ladder.joint_masses(edges).sum((1, 2))
    assert np.allclose(shares, 1 / 3, atol=1e-9)
    with pytest.raises(ValueError, match="on the line and in the plane"):
        tempering.even_log_prior(tempering.Replicas(SINUSOID, [1.0]), [1.0])


# --- parts, path space ----------------------------------------------------------------------------------------------


def test_the_index_of_parts_is_in_proportion_to_their_integrals():
    parts = [Sinusoid(0.9, 2.0), FromFunction(lambda x: 4 * x**3), Tabulated([0, 5.0])]
    joint = tempering.over_parts(parts, [Uniform(), Ramp(1.0), Tent()]).joint_masses(EDGES)
    wanted = np.stack([part.bin_masses(EDGES) for part in parts])
    assert np.allclose(joint, wanted / wanted.sum(), atol=1e-10)


def test_path_space_has_the_law_of_primary_space():
    naive = mcmc1d.Multiplexed(SINUSOID, (Uniform(),) * 2, weights.PathSpace(weights.Power(), PAIR.techniques))
    primary = mcmc1d.Multiplexed(SINUSOID, PAIR.techniques, weights.Power())
    assert np.allclose(naive.joint_masses(EDGES), primary.joint_masses(EDGES), atol=1e-10)


# --- pooled and floored ---------------------------------------------------------------------------------------------


class Shift(Inversion):
    """x = u + 2/5 around the ends: cells of a ring onto cells."""

    def quantile(self, u):
        return (u + 0.4) % 1.0

    def cdf(self, x):
        return (x + 0.6) % 1.0

    def log_prob(self, x):
        return jnp.where((x >= 0) & (x <= 1), 0.0, -jnp.inf)


@pytest.mark.parametrize("combine", [pytest.param("sum", marks=pytest.mark.slow), "maximum"])
def test_pooled_deposits_are_exact_on_a_ring(combine):
    f = np.array([1, 3, 0.5, 2, 4.0])
    share = weights.FromFunction(lambda x, p: jnp.stack([0.2 + 0.6 * (x > 0.6), 0.8 - 0.6 * (x > 0.6)]))
    multiplexed = mcmc1d.Multiplexed(Tabulated(f), (Uniform(), Shift()), share)
    target = pooled(multiplexed, combine)
    _, states = ring(np.ones(5))
    found = enumerate_kernel(PooledDeposit(RingStep(5, {1: 0.75, -1: 0.25})), target, states)
    assert found.residual < 1e-12
    given = found.law @ found.deposits
    # In units of the density's mean over the cells, what is deposited is f.
    shares = np.array([[0.2, 0.2, 0.2, 0.8, 0.8], [0.8, 0.8, 0.8, 0.2, 0.2]]) * f
    c = shares[0], np.roll(shares[1], -2)
    mean = np.mean(np.sum(c, axis=0) if combine == "sum" else np.max(c, axis=0))
    assert np.allclose(given * mean, f / 5, atol=1e-12)
    twin = mcmc1d.Metropolis(RingStep(5, {1: 0.75, -1: 0.25}))
    alone = enumerate_kernel(twin, target, states)  # the first technique's samples alone are biased
    assert np.abs(alone.law @ alone.deposits - f / f.sum()).max() > 0.01


@pytest.mark.parametrize("combine", ["sum", "maximum"])
def test_pooled_deposits_are_right_on_the_line(combine):
    """Within six standard errors of a net in eight bins (t, 7 degrees of freedom): 5e-3 a run at most."""
    target = pooled(PAIR, combine)
    net = deposit_law(PooledDeposit(StepAndChange(SmallStep(0.1))), target, EDGES, points=2**14)
    masses = SINUSOID.bin_masses(EDGES) / integral(target.target)
    assert np.all(np.abs(net.masses - masses) < 6 * net.standard_error + 1e-6)
    assert combine == "sum" or net.masses.sum() > 1.05


class _SharedAlike(OfMove):
    """The mistake: every technique's sample gets the same share of its u."""

    move: mcmc1d.moves.Move

    def check(self, target):
        pass

    def deposited(self, target):
        return PooledDeposit(self.move).deposited(target)

    def step(self, target, state, w):
        step = PooledDeposit(self.move).step(target, state, w)
        weight = step.deposits.weight.reshape(2, -1)
        alike = jnp.broadcast_to(weight.mean(1, keepdims=True), weight.shape).ravel()
        return eqx.tree_at(lambda s: s.deposits.weight, step, alike)


@pytest.mark.parametrize("combine", ["sum", "maximum"])
@pytest.mark.slow
def test_pooled_deposits_are_verified_and_shared_alike_they_are_caught(combine):
    """At level 1e-5; 2^13 replicas show a CDF gap of 0.05 in the law of the deposits with probability 0.99."""
    target, step = pooled(PAIR, combine), SmallStep(0.1)
    report = verify(PooledDeposit(step), target, replicas=2**13)
    assert report.passed
    assert "deposits: x after 64" in report.first_stage
    if combine == "sum":
        assert {failure.layer for failure in verify(_SharedAlike(step), target, replicas=2**13).failures} == {
            "deposits"
        }


def test_what_the_maximum_deposits_is_known_where_its_integral_is():
    own = PooledDeposit(SmallStep(0.1)).deposited(pooled(PAIR, "maximum"))
    assert own is not None
    assert own.target is not None
    assert 1.05 < own.total < own.most == 2
    plane = pooled(mcmc1d.Multiplexed(tempering.Replicas(SINUSOID, [1.0, 0.2]), Product((Uniform(),) * 2)), "maximum")
    with pytest.raises(ValueError, match="no target on the line"):
        verify(PooledDeposit(SmallStep(0.1)), plane, replicas=2**12)


def test_the_sum_has_the_targets_integral_and_the_floor_a_share_of_it():
    b = float(SINUSOID.bin_masses(np.array([0, 1.0]))[0])
    assert abs(integral(Pooled(PAIR)) - b) < 1e-9
    boxes = Floored(PAIR).bin_masses((np.linspace(0, 1, 4), EDGES))
    assert boxes.shape == (3, 8)
    assert abs(boxes.sum() - b / 2) < 1e-9
    halves = Floored(PAIR).bin_masses((np.linspace(0, 1, 3), EDGES)).sum(1)
    assert np.allclose(halves / halves.sum(), PAIR.joint_masses(EDGES).sum(1), atol=1e-9)


def test_the_floor_of_a_number_is_an_index():
    target = floored(PAIR)
    operator = transition_operator(SmallStep(0.2), target, points=2**17)
    law = operator.law_of(EDGES, lambda u: samples(target.target, u))
    assert np.abs(law.masses[0] - exact()).sum() / 2 < 3 * law.noise


# --- moves, bad input -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tempering.ladder(SINUSOID, [0.1, 0.5]), "does not contain the temperature 1"),
        (lambda: tempering.ladder(SINUSOID, [1.0, -0.5]), "not negative"),
        (lambda: tempering.ladder(SINUSOID, [1.0, 0.5], log_prior=[0.0]), "2 rungs must be 2 numbers"),
        (lambda: tempering.ladder(SINUSOID, []), "list of inverse temperatures"),
        (lambda: tempering.Replicas(SINUSOID, [0.5]), "does not contain the temperature 1"),
        (lambda: tempering.replicas(SINUSOID, [1.0], Product((Ramp(), Ramp()))), r"one replica's x, of shape \(\)"),
        (lambda: tempering.over_parts([SINUSOID], [Tent(), Ramp()]), "1 targets need 1 techniques"),
        (lambda: tempering.ladder(SINUSOID, [1.0], log_prior=[np.inf]), "log_scale must be finite"),
        (lambda: Tempered(SINUSOID, -1.0), "beta is an inverse temperature"),
        (lambda: Sum([]), "one target at least"),
        (lambda: Product([]), "one technique at least"),
        (lambda: PooledDeposit(SmallStep()).check(PAIR), "must be a Pooled"),
        (lambda: Exchange().check(PAIR), "must hold 2 replicas of 1 numbers"),
        (lambda: CoordinateStep(0.1, 3).check(PAIR), "there is no 3"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, Tent(), weights.Parts([SINUSOID, SINUSOID])), "one target for each"),
    ],
)
def test_what_can_not_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_large_steps_of_replicas_are_moves():
    run = mcmc1d.run(jax.random.key(1), LargeStep(), tempering.replicas(SINUSOID, [1.0, 0.2]), steps=2, chains=64)
    assert run.state.u.shape == (64, 2)
