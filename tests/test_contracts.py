"""Every example of the library keeps its contract, at the defaults: 10,000 points and all edges, both precisions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discover import examples

from mcmc1d.numerics import below_one
from mcmc1d.techniques import Inversion, Mixture, RaisedSinusoid, Ramp, Technique, Tent, within
from mcmc1d.verify import ContractError, check_move, check_technique

TECHNIQUES = examples("mcmc1d.techniques")
MOVES = examples("mcmc1d.moves")
TARGETS = {name: t for name, t in examples("mcmc1d.targets").items() if np.ndim(t.domain[0]) == 0}


OF_MANY_PARTS = (
    *("multiple_try", "moves.mixture", "exchange", "returning", "lopsided"),
    *("mixture_", "planar_mixture", "product_with_mixture", "compose_after_mixture", "compose_three", "two_periods"),
)
"""Beside a simpler one of their kind, and slow to differentiate."""


def all_of(names):
    return [
        pytest.param(name, marks=pytest.mark.slow) if any(part in name for part in OF_MANY_PARTS) else name
        for name in names
    ]


@pytest.mark.parametrize("name", all_of(TECHNIQUES))
def test_technique_keeps_its_contract(name):
    check_technique(TECHNIQUES[name]).raise_if_failed()


@pytest.mark.parametrize("name", all_of(MOVES))
def test_move_keeps_its_contract(name):
    check_move(MOVES[name]).raise_if_failed()


@pytest.mark.parametrize("name", TARGETS)
def test_bin_masses_are_those_of_quadrature(name):
    target = TARGETS[name]
    edges = np.array([-0.5, 0.0, 0.013, 0.3, 0.3001, 0.62, 0.99, 1.0, 1.7])
    assert np.allclose(target.bin_masses(edges), target.quadrature(edges), rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", [name for name in TECHNIQUES if "mixture" in name])
def test_log_determinant_of_a_mixture_is_minus_log_p(name):
    with jax.enable_x64(True):
        technique = TECHNIQUES[name]
        u = np.random.default_rng(5).random((2000, technique.dim_u))
        x, _, log_det = jax.vmap(technique.forward)(jnp.asarray(u))
        assert np.abs(log_det + jax.vmap(technique.log_prob)(x)).max() < 1e-12


def test_density_of_the_prototype_mixture_is_its_formula():
    with jax.enable_x64(True):
        x = np.linspace(0.001, 0.999, 101)
        mixture = Mixture((RaisedSinusoid(0.9), Ramp(2.0)), (0.3, 0.7))
        p = np.exp(jax.vmap(mixture.log_prob)(jnp.asarray(x)))
        assert np.allclose(p, 0.3 * (1 + 0.9 * np.sin(2 * np.pi * x)) + 0.7 * 2 * x, rtol=1e-13)


def test_where_a_derivative_is_infinite_the_report_says_so():
    assert "a derivative is infinite" in str(check_technique(Tent(), points=100))


class _WrongInverse(Inversion):
    def quantile(self, u):
        return jnp.sqrt(u)

    def cdf(self, x):
        return x**3

    def log_prob(self, x):
        return jnp.log(2 * x)


class _Collapsed(Technique):
    """Half of the cube goes to one point."""

    dim_u = 1

    def forward(self, u):
        return jnp.maximum(u[0], 0.5), u[1:], jnp.zeros(())

    def inverse(self, x, v):
        return x[None], jnp.zeros(())

    def log_prob(self, x):
        return jnp.zeros(())


class _Forgetful(Technique):
    """Reads two numbers, and returns one."""

    dim_u = 2

    def forward(self, u):
        return u[0], u[2:], jnp.zeros(())

    def inverse(self, x, v):
        return jnp.stack([x, x]), jnp.zeros(())

    def log_prob(self, x):
        return jnp.zeros(())


@pytest.mark.parametrize(
    ("technique", "equation"),
    [(_WrongInverse(), "inverse(forward(u)) = u"), (_Collapsed(), "by autodiff")],
)
def test_a_wrong_technique_fails_with_the_equation_and_the_point(technique, equation):
    report = check_technique(technique, points=500)
    assert not report
    failure = next(failure for failure in report.failures if equation in failure.equation)
    assert "u = [" in failure.where
    with pytest.raises(ContractError, match="FAIL"):
        report.raise_if_failed()


class _Weibull(Inversion):
    """k = 1/2: infinite at the finite end of an infinite support."""

    support = (0.0, np.inf)
    factor: float = 1.0

    def quantile(self, u):
        return jnp.log1p(-u) ** 2

    def cdf(self, x):
        return below_one(-jnp.expm1(-jnp.sqrt(jnp.abs(x))))

    def log_prob(self, x):
        root = jnp.sqrt(jnp.abs(x))
        return jnp.where(x >= 0, jnp.log(0.5 * self.factor / root) - root, -jnp.inf)


class _Bumpy(Inversion):
    """3 x^2, and too much of it in a window of 1e-4."""

    more: float

    def quantile(self, u):
        return jnp.cbrt(u)

    def cdf(self, x):
        return x**3

    def log_prob(self, x):
        return within(x, jnp.log(3 * x**2) + jnp.where(jnp.abs(x - 0.5) < 5e-5, self.more, 0.0))


@pytest.mark.parametrize("right", [_Weibull(), _Bumpy(0.0)], ids=["pole and tail", "smooth"])
def test_densities_that_integrate_to_one_pass(right):
    assert check_technique(right, points=500), str(check_technique(right, points=500))


@pytest.mark.parametrize("wrong", [_Weibull(1 + 1e-8), _Bumpy(0.5)], ids=["pole and tail", "narrow window"])
def test_densities_that_do_not_fail(wrong):
    """By 1e-8, and by 5e-5 in a window that 500 samples hardly meet."""
    report = check_technique(wrong, points=500)
    assert any("the integral of p is 1" in failure.equation for failure in report.failures), str(report)


def test_what_x_forgets_must_be_returned():
    with pytest.raises(ValueError, match=r"u has 2 numbers and x 1; what x forgets of u must be returned as v"):
        check_technique(_Forgetful(), points=10)


@pytest.mark.parametrize("start", [0.75, 0.0, 0.3, 1.0 - 2**-53])
def test_raised_sinusoid_inverts_to_a_few_ulps_even_where_it_is_flat(start):
    """Against its distribution function in 50 digits: at the flat place P(3/4) and from 1e-12 to 1e-2 beside it."""
    import decimal

    decimal.getcontext().prec = 50
    pi = decimal.Decimal("3.14159265358979323846264338327950288419716939937510582097494")

    def cosine(turns):
        z, term, total = (2 * pi * turns) ** 2, decimal.Decimal(1), decimal.Decimal(1)
        for k in range(1, 60):
            term *= -z / ((2 * k - 1) * (2 * k))
            total += term
        return total

    def cdf(x):
        return x + (1 - cosine(x)) / (2 * pi)

    flat = float(cdf(decimal.Decimal(start)))
    beside = np.array([0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2])
    u = np.unique(np.clip(np.concatenate([flat - beside, flat + beside]), 0, 1 - 2**-53))
    with jax.enable_x64(True):
        x = np.asarray(jax.vmap(RaisedSinusoid(1.0).quantile)(jnp.asarray(u)))
    error = [
        abs(float(cdf(decimal.Decimal(xi)) - decimal.Decimal(ui)))
        for xi, ui in zip(x.tolist(), u.tolist(), strict=True)
    ]
    assert max(error) <= 3 * 2**-53
