"""What a target must not be is said by name, with the place: NaN between the probes, negative, or unbounded."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import moves, targets, techniques
from mcmc1d.moves.multiple_try import evenly
from mcmc1d.packets import AuxiliaryCentre, PublishedDeposit
from mcmc1d.subchain import SplitSample, SubChain
from mcmc1d.targets import FromFunction
from mcmc1d.techniques import Inversion, Technique
from mcmc1d.verify import deposit_law, transition_operator
from mcmc1d.weights import Balance, Maximum, Power

NARROW = 0.300123  # no probe lies within 1e-4 of it: they are 4.9e-4 apart


def spike(value, width):
    return FromFunction(lambda x: jnp.where(jnp.abs(x - NARROW) < width, value, 1.0))


def chained(target, **changes):
    start = mcmc1d.State(np.zeros(256, np.int32), np.linspace(0.5, 0.9, 256)[:, None])
    arguments = {"steps": 2000, "chains": 256, "start": start, **changes}
    return mcmc1d.run(
        jax.random.key(0), moves.LargeStep(), mcmc1d.Multiplexed(target, techniques.Uniform()), **arguments
    )


@pytest.mark.parametrize(("value", "message"), [(jnp.nan, "NaN at x = 0.300"), (-1.0, "negative at x = 0.300.*f = -1")])
def test_a_narrow_spike_that_a_chain_meets_is_an_error(value, message):
    with pytest.raises(ValueError, match=f"{message}.*chains came upon such a place.*let it be 0 there"):
        chained(spike(value, 1e-5))


class Steep(Inversion):
    """The uniform technique, but for a density or a sample that is NaN above 3/4: what only float32 overflows to."""

    lost: str = eqx.field(static=True, default="density")

    def quantile(self, u):
        return jnp.where((u > 0.75) & (self.lost == "sample"), jnp.nan, u)

    def cdf(self, x):
        return x

    def log_prob(self, x):
        log_p = jnp.where((x >= 0) & (x <= 1), 0.0, -jnp.inf)
        return jnp.where((x > 0.75) & (self.lost == "density"), jnp.nan, log_p)


@pytest.mark.parametrize(
    ("techniques", "weights", "message"),
    [
        ((techniques.Tent(), Steep()), None, r"technique 1 \(Steep\): its log_prob is NaN at x = 0"),
        ((techniques.Tent(), Steep()), Power(), r"technique 1 \(Steep\): its log_prob is NaN at x = 0"),
        ((Steep(), techniques.Tent()), Maximum(), r"technique 0 \(Steep\): its log_prob is NaN at x = 0"),
        ((techniques.Tent(), Steep()), Maximum(), r"technique 1 \(Steep\): its log_prob is NaN at x = 0"),
        ((Steep("sample"),), None, r"technique 0 \(Steep\): its sample is NaN at u = "),
        (
            (techniques.Tent(), techniques.Uniform()),
            lambda x, p: jnp.where(x > 0.75, jnp.nan, p / p.sum()),
            "FromFunction: the weight of technique . is not finite at x = ",
        ),
    ],
)
def test_what_is_not_a_number_is_no_zero(techniques, weights, message):
    """Of a technique or a weight, as of the target: the mass there was silently lost, or all of it counted as less."""
    chain = mcmc1d.Multiplexed(targets.Sinusoid(), techniques, weights, probes=0)
    start = mcmc1d.State(np.zeros(256, np.int32), np.linspace(0.1, 0.5, 256)[:, None])
    with pytest.raises(ValueError, match=f"{message}.*came upon such a place"):
        mcmc1d.run(jax.random.key(0), moves.LargeStep(), chain, steps=50, chains=256, start=start)
    for look in (mcmc1d.normalisation, lambda key, chain: mcmc1d.exact_start(key, chain, 64)):
        with pytest.raises(ValueError, match=message):
            look(jax.random.key(0), chain)


@pytest.mark.parametrize("weights", [Balance(), Power(), Maximum()])
@pytest.mark.parametrize("log_p", [(jnp.nan, -0.5), (-0.5, jnp.nan), (-0.5, jnp.nan, 0.5)])
def test_one_density_that_is_not_a_number_leaves_no_weight(weights, log_p):
    """Nor of the techniques whose own density is known: by the maximum heuristic they had a weight of zero."""
    log_p = [jnp.float32(p) for p in log_p]
    found = [weights.log_ratio(jnp.float32(0.3), log_p, jnp.int32(i)) for i in range(len(log_p))]
    assert np.isnan([*weights.log_weights(jnp.float32(0.3), log_p), *found]).all()


def test_where_f_is_zero_weights_do_not_matter():
    """A technique whose density is NaN beyond the target's support: no law is undefined by that."""
    f = FromFunction(lambda x: jnp.where(x < 0.7, 1.0, 0.0), breaks=(0.7,))
    chain = mcmc1d.Multiplexed(f, (techniques.Tent(), Steep()), probes=0)
    found = mcmc1d.normalisation(jax.random.key(0), chain)
    assert abs(found.value - 0.7) < 6 * found.standard_error
    mcmc1d.run(jax.random.key(0), moves.LargeStep(), chain, steps=50, chains=256)


class Loud(targets.Sinusoid):
    """In a unit in which float32 does not hold it."""

    def log_f(self, x):
        return targets.Sinusoid().log_f(x) + 100


def test_a_density_that_only_float32_can_not_hold_is_told_as_that():
    chain = mcmc1d.Multiplexed(Loud(), techniques.Uniform())
    with pytest.raises(ValueError, match=r"logarithm reaches \d+\.\d+, and it is infinite in float32"):
        mcmc1d.exact_start(jax.random.key(0), chain, 64)
    b = mcmc1d.normalisation(jax.random.key(0), chain, 2**14)  # whose sums are in float64
    assert abs(b.value / np.exp(100) - 1) < 6 * b.standard_error / np.exp(100)


class Scaled(targets.Sinusoid):
    """Times e^log_scale."""

    log_scale: float = 0.0

    def log_f(self, x):
        return targets.Sinusoid().log_f(x) + self.log_scale

    def bin_masses(self, edges):
        return self.quadrature(edges)


def test_a_scale_that_floats_do_not_hold_is_told_as_that():
    """It was NaN or zero, with a warning at most."""
    low, lower = (
        mcmc1d.Multiplexed(Scaled(log_scale=scale), techniques.Uniform(), probes=0) for scale in (-120.0, -2000.0)
    )
    b = mcmc1d.normalisation(jax.random.key(0), low, 2**14)
    assert abs(b.value / np.exp(-120) - 1) < 6 * b.standard_error / np.exp(-120)
    edges = np.linspace(0, 1, 4)
    for look in (
        lambda: mcmc1d.normalisation(jax.random.key(0), lower, 2**14),
        lambda: lower.joint_masses(edges),
        lambda: deposit_law(moves.SmallStep(), low, edges, points=1024),
        lambda: transition_operator(moves.SmallStep(), low, points=2**12),
    ):
        with pytest.raises(ValueError, match="add a constant to"):
            look()


class Pole(Technique):
    """x = u^2, of density x^(-1/2) / 2, which is infinite at 0."""

    dim_u = 1

    def forward(self, u):
        return u[0] ** 2, u[1:], jnp.log(2 * u[0])

    def inverse(self, x, v):
        return jnp.concatenate([jnp.sqrt(x)[None], v]), -jnp.log(2 * jnp.sqrt(x))

    def log_prob(self, x):
        return jnp.where((x >= 0) & (x <= 1), -jnp.log(2 * jnp.sqrt(x)), -jnp.inf)


def test_at_a_pole_that_the_technique_has_too_there_is_no_mass():
    """It was NaN at u = 0, which float32 draws once in 2^23: exact starts and b failed at random."""
    chain = mcmc1d.Multiplexed(FromFunction(lambda x: x**-0.5), Pole(), probes=0)
    at = chain.evaluate(mcmc1d.State(jnp.zeros((), jnp.int32), jnp.zeros(1)))
    assert np.isneginf(at.seen.log_c)
    beside = chain.evaluate(mcmc1d.State(jnp.zeros((), jnp.int32), jnp.full(1, 1e-6)))
    assert np.isclose(beside.seen.log_c, np.log(2))


class Everywhere(targets.Sinusoid):
    """It forgets to be zero outside its domain."""

    def log_f(self, x):
        return -0.5 * ((x - 0.9) / 0.2) ** 2


def test_a_target_that_goes_on_outside_its_domain_is_refused():
    """Samples there counted in the end bins."""
    wide = techniques.PiecewiseConstant([-1, 0, 1, 2], [1, 2, 1])
    with pytest.raises(ValueError, match=r"positive at x = .*, outside its domain 0.0 to 1.0"):
        mcmc1d.Multiplexed(Everywhere(), wide)
    mcmc1d.Multiplexed(Everywhere(), techniques.Uniform())  # which does not reach it


@pytest.mark.parametrize(
    "kernel",
    [
        moves.MultipleTry(moves.LargeStep(), 4),
        moves.MultipleTry(moves.LargeStep(), 3, evenly),
        AuxiliaryCentre(moves.LargeStep(), 4),
        SplitSample(moves.LargeStep(), 4),
        SubChain(moves.SmallStep(1e-4), moves.LargeStep(), 4),
    ],
)
def test_a_kernel_of_many_candidates_does_not_pass_it_over(kernel):
    """A hundredth of the domain is undefined: 256 chains come upon it in a few steps."""
    target = FromFunction(lambda x: jnp.where(jnp.abs(x - 0.3) < 0.005, jnp.nan, 1.0))
    start = mcmc1d.State(np.zeros(256, np.int32), np.linspace(0.5, 0.9, 256)[:, None])
    chain = mcmc1d.Multiplexed(target, techniques.Uniform(), probes=0)
    with pytest.raises(ValueError, match=r"NaN at x = 0\.(29|30)"):
        mcmc1d.run(jax.random.key(0), kernel, chain, steps=40, chains=256, start=start)


@pytest.mark.parametrize(
    "kernel",
    [
        moves.MultipleTry(moves.LargeStep(), 3),
        PublishedDeposit(moves.MultipleTry(moves.LargeStep(), 3)),
        AuxiliaryCentre(moves.LargeStep(), 3),
        moves.LargeStep(),
    ],
)
def test_a_dark_start_is_left(kernel):
    target = mcmc1d.Multiplexed(targets.Tabulated([0, 1]), techniques.Uniform())
    start = mcmc1d.State(np.zeros(64, np.int32), np.full((64, 1), 0.2))
    run = mcmc1d.run(jax.random.key(0), kernel, target, steps=40, chains=64, start=start)
    assert np.all(np.asarray(run.state.u) >= 0.5)


def test_a_start_at_an_undefined_place_is_an_error():
    u = np.float32(0.2500001)
    target = FromFunction(lambda x: jnp.where(x == u, jnp.nan, 1.0))
    start = mcmc1d.State(np.zeros(8, np.int32), np.full((8, 1), u))
    with pytest.raises(ValueError, match=r"FromFunction is NaN at x = 0.250000\d*; 8 of 8 chains"):
        chained(target, chains=8, blocks=1, steps=1, start=start)


def test_a_trace_says_it_too():
    target = mcmc1d.Multiplexed(spike(jnp.nan, 1e-5), techniques.Uniform())
    start = mcmc1d.State(np.zeros(256, np.int32), np.full((256, 1), 0.5))
    with pytest.raises(ValueError, match=r"is NaN at x = 0\.300"):
        mcmc1d.trace(jax.random.key(0), moves.LargeStep(), target, steps=2000, chains=256, start=start)


def test_a_proposal_outside_the_cube_is_no_fault_of_the_target():
    class Outside(moves.Move):
        def dim_w(self, target):
            return 1

        def propose(self, target, state, w):
            return moves.Proposal(mcmc1d.State(state.index, state.u * jnp.nan), w, jnp.zeros((), w.dtype))

    target = mcmc1d.Multiplexed(spike(1.0, 1e-5), techniques.Uniform())
    run = mcmc1d.run(jax.random.key(0), Outside(), target, steps=3, chains=8)
    assert np.isfinite(run.state.u).all()


def test_exact_starts_name_the_place_too():
    target = mcmc1d.Multiplexed(spike(-2.0, 1e-5), techniques.Uniform())
    with pytest.raises(ValueError, match=r"negative at x = 0.300\d*: f = -2"):
        mcmc1d.exact_start(jax.random.key(0), target, 10**6)


def test_a_negative_function_is_told_with_its_value():
    with pytest.raises(ValueError, match=r"FromFunction is negative at x = 0.000\d*: f = -0.499756"):
        mcmc1d.Multiplexed(FromFunction(lambda x: x - 0.5), techniques.Uniform())


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("function", [lambda x: 1 / x, lambda x: x**-0.9, lambda x: 1 / jnp.abs(x - 0.4999)])
def test_an_unbounded_density_is_refused_at_once(function, wide):
    target = mcmc1d.Multiplexed(FromFunction(function), techniques.Uniform())
    with jax.enable_x64(wide), pytest.raises(ValueError, match=r"pole.*give a technique|give a technique.*pole"):
        mcmc1d.exact_start(jax.random.key(0), target, 10**5)


@pytest.mark.slow
def test_an_integral_that_is_infinite_is_refused():
    for function, interval in ((lambda x: 1 / x, r"\[0, 0.1\]"), (lambda x: 1 / jnp.abs(x - 0.3), r"\[0.\d, 0.\d\]")):
        with pytest.raises(ValueError, match=f"unbounded in {interval}, and its integral there is infinite"):
            FromFunction(function).bin_masses(np.linspace(0, 1, 11))


def test_a_pole_at_zero_that_can_be_integrated_is():
    masses = FromFunction(lambda x: x**-0.5).bin_masses(np.array([0, 0.25, 1]))
    np.testing.assert_allclose(masses, [1, 1], rtol=1e-10)


class Given(Balance):
    """Whose logarithm of w / p is a number that is given."""

    ratio: float = 0.0

    def log_ratio(self, x, log_p, index, p=None):
        return jnp.asarray(self.ratio)


NUMBERS = (0.5, 0.0, -np.inf, np.inf, np.nan)


@pytest.mark.parametrize("ratio", NUMBERS)
def test_what_is_dark_and_what_is_undefined(ratio):
    """What is dark stays dark whatever else is undefined, but for a NaN of the target or of the point itself."""
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Uniform(), Given(ratio=ratio), probes=0)
    for log_f in NUMBERS:
        for x in (0.3, np.nan):
            if np.isnan(log_f) or np.isnan(x):
                expected = np.inf
            elif -np.inf in (log_f, ratio):
                expected = -np.inf
            else:
                expected = np.inf if np.isnan(ratio) else ratio + log_f
            found = target.log_c(0, jnp.asarray(x), jnp.asarray(log_f), (jnp.asarray(0.0),))
            assert found == expected, (ratio, log_f, x)
