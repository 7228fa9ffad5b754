"""The engine: verdicts on right and wrong kernels of every form, what is refused, and that a seed means something."""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from scipy.special import ndtr

import mcmc1d
from mcmc1d import moves, verify
from mcmc1d.verify import HostKernel, JaxKernel, Law, LawError, Ledger, Scheme, Verdict, laws
from mcmc1d.verify.mutants.proposals import walk

SMALL = {"replicas": 2**13}
NORMAL = laws.normal(1)
WALK = walk(NORMAL, 2.0)


def pairs(rng, n):
    return rng.normal(size=(n, 2))


def independent(key, x):
    """Fresh draws, with no accept test: right, and it compiles in no time."""
    return jax.random.normal(key, x.shape)


def host_walk(rng, x):
    y = x + rng.normal(size=x.shape)
    return np.where(np.log(rng.random(len(x))) < (x * x - y * y) / 2, y, x)


# --- verdicts ---


@pytest.mark.parametrize(
    ("kernel", "law", "options"),
    [
        (WALK, NORMAL, {"reversible": True}),
        (lambda key, x: (independent(key, x), {"note": 1}), laws.normal(2), {}),
        (HostKernel(host_walk, reversible=True), NORMAL, {}),
        (independent, scipy.stats.norm(), {}),
        (lambda key, x: jax.random.randint(key, (), 2, 7).astype(x.dtype), scipy.stats.randint(2, 7), {}),
    ],
    ids=["reversible", "with info", "host", "scipy", "scipy discrete"],
)
def test_right_kernels_of_every_form_pass(kernel, law, options):
    """False alarms: 1e-5 each."""
    report = verify.verify(kernel, law, **SMALL, **options)
    assert report.verdict is Verdict.PASS, str(report)
    assert report.forgotten is not None


@pytest.mark.parametrize(
    ("kernel", "law", "options", "reason"),
    [
        (lambda key, x: x, laws.normal(2), {}, "never moves"),
        (lambda key, x: -x, NORMAL, {}, "deterministic"),
        (lambda key, x: x.at[0].set(jax.random.normal(key)), laws.normal(2), {}, r"never moves x\[1\]"),
        (lambda key, x: 0.9 * independent(key, x), NORMAL, {}, "the law of"),
        (lambda key, x: jnp.where(x > 2, jnp.nan, x + 0.01), NORMAL, {}, "returns nan"),
        (lambda key, x: x + 3 * jax.random.normal(key), laws.walls(), {}, "leave the support"),
        (lambda key, x: jnp.full(2, jax.random.normal(key)), laws.normal(2), {}, "the joint law of"),
        (HostKernel(lambda rng, x: 1.1 * rng.normal(size=x.shape)), NORMAL, {}, "the law of"),
        (lambda key, x: jnp.where(x > 0, -1, 1) * jnp.abs(independent(key, x)), NORMAL, {}, "periodic"),
    ],
    ids=["identity", "flip", "half", "narrow", "nan", "outside", "copies", "host", "periodic"],
)
def test_wrong_kernels_fail_for_their_reason(kernel, law, options, reason):
    report = verify.verify(kernel, law, **SMALL, **options)
    assert report.verdict is Verdict.FAIL
    with pytest.raises(verify.VerificationError, match=reason):
        report.raise_if_failed()


def test_a_kernel_that_is_not_what_it_is_declared_fails():
    """A rotation that is right and only ever goes up, declared reversible; undeclared it passes."""
    law = Law(lambda rng, n: rng.random(n), cdf=lambda x: np.clip(x, 0, 1), support=(0.0, 1.0), name="uniform")

    def turn(key, x):
        y = x + 0.2 * jax.random.uniform(key)
        return y - jnp.floor(y)

    assert verify.verify(turn, law, **SMALL).passed
    report = verify.verify(turn, law, reversible=True, **SMALL)
    assert {failure.layer for failure in report.failures} == {"exchangeability"}


@pytest.mark.slow
def test_a_slow_kernel_is_inconclusive():
    report = verify.verify(walk(NORMAL, 0.003), NORMAL, **SMALL)
    assert report.verdict is Verdict.INCONCLUSIVE
    assert "not forgotten a bad start" in str(report)


@pytest.mark.slow
def test_a_power_out_of_reach_is_inconclusive():
    """A host kernel that takes 2 ms a call can not draw enough in the time given."""
    import time

    def slow(rng, x):
        time.sleep(0.002)
        return rng.normal(size=x.shape)

    report = verify.verify(HostKernel(slow), NORMAL, gap=0.001, seconds=0.2)
    assert report.verdict is Verdict.INCONCLUSIVE
    assert "out of reach" in str(report)
    assert report.gap > 0.001


def test_too_few_replicas_are_no_pass():
    """Without a gap of the user's, 0.05 must be shown, whoever has chosen the number."""
    report = verify.verify(independent, NORMAL, replicas=100)
    assert report.verdict is Verdict.INCONCLUSIVE
    assert "out of reach" in str(report)
    assert verify.verify(independent, NORMAL, replicas=100, gap=0.5).passed


@pytest.mark.slow
def test_orthants_of_many_coordinates():
    """Three of five coordinates whose signs multiply to the sign that they had: every pair is right."""

    def parity(key, x):
        y = jax.random.normal(key, x.shape)
        return y.at[0].multiply(jnp.sign(jnp.prod(y[:3])))

    report = verify.verify(parity, laws.normal(5), **SMALL)
    assert {failure.layer for failure in report.failures} == {"joint"}
    assert verify.verify(independent, laws.normal(5), **SMALL).passed


def test_half_a_sweep_is_right_and_may_say_so():
    law = laws.correlated(0.8)

    def half(key, x):
        return x.at[0].set(0.8 * x[1] + 0.6 * jax.random.normal(key))

    assert "ergodic=False" in str(verify.verify(half, law, **SMALL))
    assert verify.verify(half, law, ergodic=False, **SMALL).passed


# --- moves of the library ---


@pytest.fixture(scope="module")
def multiplexed():
    return mcmc1d.Multiplexed(
        mcmc1d.targets.GaussianMixture([-0.02, 0.6], [0.1, 0.2], [0.4, 0.6]),
        (mcmc1d.techniques.Tent(0.3), mcmc1d.techniques.PiecewiseConstant([0, 0.5, 1], [1.6, 0.4])),
    )


def mixed(jump):
    return moves.Mixture({"small": (0.5, moves.SmallStep(0.1)), "jump": (0.5, jump)})


def test_a_move_is_verified_with_its_deposits_and_its_joint_law(multiplexed):
    report = verify.verify(mixed(moves.ReversibleJump()), multiplexed, replicas=2**15)
    assert report.passed, str(report)
    assert {"marginal", "joint", "exchangeability", "deposits"} <= {result.layer for result in report.results}


def test_a_wrong_move_is_named(multiplexed):
    """The diagnosis names the jump and not the small step, with the cells between which it is out of balance."""
    from mcmc1d.verify.mutants.jumps import no_jacobian

    report = verify.verify(mixed(no_jacobian(moves.ReversibleJump())), multiplexed, replicas=2**15)
    assert report.verdict is Verdict.FAIL
    small, jump = report.diagnosis
    assert "small: no violation" in small
    assert "jump: breaks detailed balance" in jump
    assert "technique" in jump


# --- seeds and levels ---


def test_a_seed_means_the_same_numbers_and_another_others():
    first, again, other = (verify.verify(WALK, NORMAL, seed=s, **SMALL) for s in (3, 3, 4))
    assert first.first_stage == again.first_stage
    assert first.first_stage != other.first_stage
    named = verify.verify(WALK, NORMAL, seed=3, name="another test", **SMALL)
    assert named.first_stage != first.first_stage


def test_no_numbers_are_shared_by_starts_and_steps():
    """A host kernel that draws as the law does: were the seeds one, its step would repeat the start."""
    seen = []

    def spy(rng, x):
        seen.append(np.corrcoef(x, y := rng.normal(size=x.shape))[0, 1])
        return y

    verify.verify(HostKernel(spy), NORMAL, **SMALL)
    # 8192 / sqrt(8192): under the hypothesis |r| > 0.1 has probability 1e-19 a call.
    assert max(abs(r) for r in seen if np.isfinite(r)) < 0.3


@pytest.mark.parametrize(("replicas", "verdict"), [(1280, Verdict.INCONCLUSIVE), (2048, Verdict.FAIL)])
def test_what_few_replicas_have_not_moved_may_move(replicas, verdict):
    """In any of two coordinates that move in 1 of 100: 0.99^1280 = 3e-6 each, 0.99^2048 = 1e-9, a hundredth of 1e-5."""
    report = verify.verify(lambda key, x: x.at[0].set(jax.random.normal(key)), laws.normal(2), replicas=replicas)
    assert report.verdict is verdict
    assert "never moves x[1]" in str(report)


def test_false_alarms_of_the_sequential_scheme():
    """20,000 runs on uniform p-values at level 0.2: more than 5 standard deviations over has probability 3e-7.

    Its twin is the naive scheme that tests each stage at the full level: it exceeds that.
    """
    rng = np.random.default_rng(0)
    scheme, runs = Scheme(0.2), 20_000

    def alarms(early, decide):
        count = 0
        for _ in range(runs):
            if rng.random() <= early:
                count += 1
                continue
            for stage in range(1, scheme.stages + 1):
                said = decide(stage, rng.random())
                if said != "more":
                    count += said == "fail"
                    break
        return count / runs

    slack = 5 * np.sqrt(0.2 * 0.8 / runs)
    assert alarms(scheme.early, scheme.decide) <= 0.2 + slack
    assert (
        alarms(0.2, lambda stage, p: "fail" if p <= 0.2 else "more" if stage < 3 and p < 0.9 else "pass") > 0.2 + slack
    )


def test_a_ledger_never_deals_more_than_it_has():
    ledger = Ledger(1e-4)
    assert sum(ledger.share(f"test {k}") for k in range(1000)) < 1e-4
    with pytest.raises(ValueError, match="already dealt"):
        ledger.share("test 3")
    few = Ledger(1e-4, expected=2)
    assert few.share("a") + few.share("b") == pytest.approx(1e-4)
    with pytest.raises(ValueError, match="one more"):
        few.share("c")
    report = verify.verify(independent, NORMAL, ledger=Ledger(1e-4), name="mine", **SMALL)
    assert report.level == pytest.approx(5e-5)


# --- what is said ---


def test_a_certificate_is_json_and_a_plot_is_drawn():
    report = verify.verify(lambda key, x: 0.9 * independent(key, x), NORMAL, **SMALL)
    record = json.loads(report.to_json())
    assert record["verdict"] == "FAIL"
    assert {"jax", "numpy", "python"} <= record["versions"].keys()
    assert record["seed"] == 0
    assert record["first_replicas"] == 2**13
    figure = report.plot()
    assert len(figure.axes) >= 2
    assert "where" in record["results"][0]
    assert any("s.d." in place for result in report.failures for place in result.where)


# --- what is refused ---


@pytest.mark.parametrize(
    ("kernel", "law", "options", "message"),
    [
        (lambda key, x: jnp.stack([x, x]), NORMAL, {}, r"must return what it was given, float32\[\]"),
        (lambda key, x: x.astype(jnp.int32), NORMAL, {}, "returned int32"),
        (lambda key, x: x + 1 if x > 0 else x, NORMAL, {}, "HostKernel"),
        (HostKernel(lambda rng, x: x[:2]), NORMAL, {}, "shapes it was given"),
        (3, NORMAL, {}, "no kernel"),
        (JaxKernel, NORMAL, {}, "not the class"),
        (moves.SmallStep(), NORMAL, {}, "Multiplexed"),
        (WALK, object(), {}, "verify.Law"),
        (WALK, scipy.stats.norm, {}, "freeze"),
        (WALK, NORMAL, {"seconds": -1.0}, "seconds"),
        (WALK, NORMAL, {"steps": (4, 1)}, "rise from 1 on"),
        (WALK, NORMAL, {"power": 1.0}, "power"),
        (WALK, NORMAL, {"replicas": 3}, "too few"),
        (WALK, NORMAL, {"level": 0.0}, "level"),
        (WALK, NORMAL, {"gap": 2.0}, "gap"),
        (WALK, NORMAL, {"seed": -1}, "seed"),
        (WALK, Law(lambda rng, n: rng.normal(size=n + 1), cdf=ndtr), {}, "must return"),
        (WALK, Law(lambda rng, n: np.full(n, np.nan), cdf=ndtr), {}, "NaN"),
        (
            lambda key, x: x,
            Law(lambda rng, n: dict(zip("ab", pairs(rng, n).T, strict=True)), cdf=ndtr),
            {},
            "positions that are one array",
        ),
        (
            lambda key, x: x,
            Law(pairs, bins=(np.array([-9.0, 0.0, 9.0]), np.array([0.5, 0.5]))),
            {},
            "bins= is for positions on the line",
        ),
        (
            lambda key, x: x,
            Law(lambda rng, n: {"a": {"b": pairs(rng, n)[:, 0]}, "a.b": pairs(rng, n)[:, 0]}),
            {},
            "two coordinates of a position would be called",
        ),
        (WALK, Law(lambda rng, n: rng.normal(size=n), cdf=lambda x: x), {}, "must lie in"),
        (WALK, Law(lambda rng, n: rng.normal(size=n), cdf=lambda x: 0.5), {}, "must return shape"),
        (WALK, Law(lambda rng, n: rng.normal(size=n), cdf=lambda x: ndtr(-x)), {}, "the cdf of x falls"),
        (WALK, Law(lambda rng, n: rng.normal(size=n), cdf=math.erf), {}, "a cdf takes many values at once"),
        (WALK, scipy.stats.lognorm(40), {}, "of the law's draws, such as .*, do not fit float32.*enable_x64"),
        (HostKernel(lambda rng, x: x + 1 if x > 0 else x), NORMAL, {}, "is of one chain: a HostKernel's step"),
        (JaxKernel(lambda key, state: (state[0], state[1])), NORMAL, {}, "IndexError: Too many indices"),
        (WALK, scipy.stats.norm(1e6, 1), {}, r"in float32 x has steps of 0.06.*enable_x64"),
    ],
)
def test_what_can_not_be_verified_is_refused_in_words(kernel, law, options, message):
    with pytest.raises(ValueError, match=message):
        verify.verify(kernel, law, **{**SMALL, **options})


def test_a_law_that_contradicts_itself_is_an_error_and_no_verdict():
    law = Law(lambda rng, n: 1.1 * rng.normal(size=n), cdf=ndtr, name="mine")
    with pytest.raises(LawError, match="mine: its sampler and its exact law of x disagree"):
        verify.verify(WALK, law, **SMALL)


def test_deposits_beyond_their_bound_are_refused():
    kernel = JaxKernel(independent, deposits=lambda x, _: (x[None], jnp.full(1, 2.0)))
    with pytest.raises(ValueError, match="max_weight"):
        verify.verify(kernel, NORMAL, **SMALL)


@pytest.mark.slow
def test_deposits_of_random_total_are_right_if_their_expectation_is():
    """Weight 0 or 2 with equal probability: right. 0 or 1.9: caught."""

    def kernel(total):
        def step(key, x):
            first, second = jax.random.split(key)
            return jax.random.normal(first), jax.random.bernoulli(second)

        return JaxKernel(step, deposits=lambda x, heads: (x[None], jnp.where(heads, total, 0.0)[None]))

    assert verify.verify(kernel(2.0), NORMAL, max_weight=2.0, **SMALL).passed
    report = verify.verify(kernel(1.6), NORMAL, max_weight=2.0, **SMALL)
    assert {failure.layer for failure in report.failures} == {"deposits"}


def test_an_index_that_has_one_value_need_not_move():
    target = mcmc1d.Multiplexed(mcmc1d.targets.Sinusoid(), mcmc1d.techniques.Uniform())
    assert verify.verify(moves.SmallStep(0.1), target, **SMALL).passed
