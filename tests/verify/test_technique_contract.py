"""What the contract of a technique sees outside the support, at poles and at zeros, and in what v says of x."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.numerics import below_one
from mcmc1d.techniques import (
    Inversion,
    Mixture,
    Product,
    RaisedSinusoid,
    Ramp,
    Technique,
    Tent,
    TruncatedNormal,
    Uniform,
    within,
)
from mcmc1d.verify import check_technique
from mcmc1d.verify.mutants.mixtures import PriorLobe


class Kumaraswamy(Inversion):
    """a b x^(a-1) (1 - x^a)^(b-1): poles at both ends where a and b are under 1."""

    a: float
    b: float
    factor: float = 1.0

    def quantile(self, u):
        return (1 - (1 - u) ** (1 / self.b)) ** (1 / self.a)

    def cdf(self, x):
        return 1 - (1 - x**self.a) ** self.b

    def log_prob(self, x):
        a, b = self.a, self.b
        return within(x, jnp.log(self.factor * a * b) + (a - 1) * jnp.log(x) + (b - 1) * jnp.log1p(-(x**a)))


class Normal(Inversion):
    """The normal density on the whole line: x is -inf at u = 0."""

    support = (-np.inf, np.inf)
    beyond: float = 0.0

    def quantile(self, u):
        return jax.scipy.special.ndtri(u)

    def cdf(self, x):
        return jax.scipy.special.ndtr(x)

    def log_prob(self, x):
        return -x * x / 2 - 0.5 * jnp.log(2 * jnp.pi)


class Unfenced(Technique):
    """A tent that forgets where it ends, in one of the two places that must know."""

    density: bool
    dim_u = 1

    def forward(self, u):
        return Tent(0.3).forward(u)

    def inverse(self, x, v):
        u, log_det = Tent(0.3).inverse(x, v)
        return u, log_det if self.density else jnp.where(log_det > -jnp.inf, log_det, 0)

    def log_prob(self, x):
        log_p = Tent(0.3).log_prob(x)
        return jnp.where((x < 0) | (x > 1), -1.0, log_p) if self.density else log_p


class Elsewhere(Inversion):
    """On [1, 3], and does not say so."""

    def quantile(self, u):
        return 1 + 2 * u

    def cdf(self, x):
        return (x - 1) / 2

    def log_prob(self, x):
        return within(x, jnp.full_like(x, -jnp.log(2.0)), 1, 3)


class PriorLobeRight(Technique):
    """The lobe chosen by the prior, with its own determinant -log p_lobe: right, and not the density pointwise."""

    mixture: Mixture
    claimed: Mixture

    @property
    def dim_u(self):
        return self.mixture.dim_u

    def forward(self, u):
        x, v, _ = PriorLobe(self.mixture).forward(u)
        return x, v, -self.inverse(x, v)[1]

    def inverse(self, x, v):
        u, _ = PriorLobe(self.mixture).inverse(x, v)
        log_p = [lobe.log_prob(x) for lobe in self.mixture.lobes]
        return u, jnp.where(v[0] < self.mixture.weights[0], log_p[0], log_p[1])

    def log_prob(self, x):
        return self.claimed.log_prob(x)


def lobes(weight):
    return Mixture((RaisedSinusoid(0.9), Ramp(1.5)), (weight, 1 - weight))


def failed(technique, equation):
    return [failure for failure in check_technique(technique, points=1000).failures if equation in failure.equation]


@pytest.mark.parametrize(("a", "b"), [(0.5, 0.5), (2.0, 0.5), (0.5, 2.0), (0.4, 0.6)])
def test_a_pole_at_either_end_is_no_mistake(a, b):
    check_technique(Kumaraswamy(a, b)).raise_if_failed()


def test_the_integral_next_to_a_pole_is_sharp_and_the_report_says_how_sharp():
    assert "off by less than 4.2e-08 would pass" in str(check_technique(Kumaraswamy(0.5, 0.5), points=100))
    assert failed(Kumaraswamy(0.5, 0.5, 1 + 1e-6), "the integral of p is 1")
    assert failed(Kumaraswamy(0.5, 2.0, 1 + 1e-8), "the integral of p is 1")


@pytest.mark.parametrize("factor", [0.99, 1.001])
def test_float32_is_not_blinded_by_the_allowance_for_poles(factor):
    wrong = eqx.tree_at(lambda t: t.factor, Kumaraswamy(0.5, 0.5), factor)
    assert [f for f in failed(wrong, "forward's log_det = log|det") if f.equation.startswith("float32")]


def test_an_infinite_sample_where_the_density_is_zero_is_allowed_and_said():
    report = check_technique(Normal())
    assert report.raise_if_failed()
    assert "x is infinite at 1 points, where the density is zero" in str(report)


@pytest.mark.parametrize("density", [True, False])
def test_outside_the_support_both_densities_are_zero(density):
    failure = failed(Unfenced(density), "outside the support")[0]
    assert "outside the support [0.0, 1.0], the default" in failure.where


def test_a_sample_outside_the_default_support_says_that_it_is_the_default():
    failure = failed(Elsewhere(), "x is in the support")[0]
    assert "x must be finite and in the support [0.0, 1.0], the default: define `support`" in failure.where
    assert "v must be" not in failure.where


@pytest.mark.slow
def test_where_v_says_something_of_x_the_density_is_the_integral_over_v():
    report = check_technique(PriorLobeRight(lobes(0.3), lobes(0.3)), points=1000)
    assert report.raise_if_failed()
    assert "p off by more than" in str(report)


@pytest.mark.parametrize("claimed", [0.7, 0.302])
def test_a_wrong_density_there_is_caught_though_it_integrates_to_one(claimed):
    report = check_technique(PriorLobeRight(lobes(0.3), lobes(claimed)), points=1000)
    assert {failure.equation.partition(": ")[2][:19] for failure in report.failures} == {"p(x) = integral ove"}


class TooLarge(Ramp):
    """A ramp whose `prob` is not quite `log_prob`'s."""

    def prob(self, x):
        return 1.001 * Ramp.prob(self, x)


class NotZeroOutside(Ramp):
    """A ramp whose `prob` goes on beyond its support."""

    def prob(self, x):
        return jnp.where((x < 0) | (x > 1), 0.1, Ramp.prob(self, x))


def test_the_density_and_its_logarithm_must_agree_inside_and_outside():
    """The balance heuristic takes the one, jumps the other."""
    assert check_technique(Ramp(1.0), points=200)
    for wrong in (TooLarge(1.0), NotZeroOutside(1.0)):
        broken = [check.equation for check in check_technique(wrong, points=200).failures]
        assert [equation.partition(": ")[2][:23] for equation in broken] == ["prob(x) = exp(log_prob("] * 2


class Pareto(Inversion):
    """a / x^(1 + a) from 1 on; the derivative of x at the last u is beyond float32. `off` is added to the exponent."""

    off: float = 0.0
    support = (1.0, np.inf)

    def quantile(self, u):
        return (1 - u) ** -5.0

    def cdf(self, x):
        return 1 - x**-0.2

    def log_prob(self, x):
        return jnp.where(x >= 1, jnp.log(0.2) - (1.2 + self.off) * jnp.log(jnp.maximum(x, 1)), -jnp.inf)


class Square(Inversion):
    """2 x, whose largest x rounds to 1."""

    def quantile(self, u):
        return jnp.sqrt(u)

    def cdf(self, x):
        return x**2

    def log_prob(self, x):
        return within(x, jnp.log(2 * x))


def test_a_derivative_beyond_the_largest_float():
    assert check_technique(Pareto(), points=2000)
    assert not check_technique(Pareto(0.01), points=2000)


@pytest.mark.parametrize("factor", [1.0, 1.001])
def test_a_lobe_whose_samples_round_to_the_pole_of_another(factor):
    """At a pole there is no way back, and next to one the last bit of x is all that there is; elsewhere it is seen."""
    mixture = Mixture((Kumaraswamy(0.5, 0.5, factor), Square()), (0.5, 0.5))
    assert bool(check_technique(mixture, points=2000)) == (factor == 1)


class Patch(Technique):
    """The unit square, whose density claims a patch beside it too, of a mass of 0.002."""

    mass: float
    support = (np.zeros(2), np.array([1.25, 1.25]))
    dim_u = 2

    def forward(self, u):
        return u, u[2:], jnp.zeros(())

    def inverse(self, x, v):
        return x, self.log_prob(x)

    def log_prob(self, x):
        beside = jnp.all((x >= 1.1) & (x <= 1.15))
        return jnp.where(jnp.all((x >= 0) & (x < 1)), 0.0, jnp.where(beside, jnp.log(self.mass / 0.05**2), -jnp.inf))


def test_a_density_beside_all_samples_is_seen_by_itself():
    """The integral may be off by 0.01. The patch is 1.6e-3 of the support: 1e4 points miss it with probability 1e-7."""
    assert check_technique(Patch(0.0))
    report = check_technique(Patch(0.002))
    assert "float64: log_prob is finite at samples only" in {c.equation for c in report.checks if not c.passed}


class LinearDisk(Technique):
    """A disk whose radius is uniform: p = 1 / (2 pi r), with a pole in the middle of its box, where cubature looks."""

    factor: float = 1.0
    dim_u = 2
    support = (np.array([-1.0, -1.0]), np.array([1.0, 1.0]))

    def forward(self, u):
        angle = 2 * jnp.pi * u[1]
        return u[0] * jnp.stack([jnp.cos(angle), jnp.sin(angle)]), u[2:], jnp.log(2 * jnp.pi * u[0])

    def inverse(self, x, v):
        turn = jnp.arctan2(x[1], x[0]) / (2 * jnp.pi)
        return below_one(jnp.stack([jnp.hypot(x[0], x[1]), turn - jnp.floor(turn)])), self.log_prob(x)

    def log_prob(self, x):
        r = jnp.hypot(x[0], x[1])
        return jnp.where(r < 1, jnp.log(self.factor) - jnp.log(2 * jnp.pi * r), -jnp.inf)


def test_a_pole_in_the_plane_is_no_mistake_and_hides_none():
    assert check_technique(LinearDisk())
    failed = {check.equation for check in check_technique(LinearDisk(1.05)).checks if not check.passed}
    assert "the integral of p is 1" in failed


class Ablaze(LinearDisk):
    """Infinite on a strip of its box, where nothing is."""

    def log_prob(self, x):
        return jnp.where((x[0] > 0.9) & (x[1] > 0.5), jnp.inf, super().log_prob(x))


def test_an_infinite_density_on_a_strip_is_no_pole():
    assert "the integral of p is 1" in {
        check.equation for check in check_technique(Ablaze()).checks if not check.passed
    }


def test_a_tail_that_no_number_leads_to_is_no_mistake():
    """Half of the box is so far out that the CDF rounds to 1, and the density is 1e-34 there, not zero."""
    assert check_technique(Product((TruncatedNormal(-0.4, 0.1), Uniform())))


class Bisection(Inversion):
    """Beta(2, 2), its quantile by halving an interval: right, and flat to autodiff."""

    def quantile(self, u):
        def halve(_, ends):
            lower, upper = ends
            middle = (lower + upper) / 2
            above = self.cdf(middle) < u
            return jnp.where(above, middle, lower), jnp.where(above, upper, middle)

        return sum(jax.lax.fori_loop(0, 60, halve, (jnp.zeros_like(u), jnp.ones_like(u)))) / 2

    def cdf(self, x):
        return x * x * (3 - 2 * x)

    def log_prob(self, x):
        return within(x, jnp.log(6 * x * (1 - x)))


def test_a_map_that_autodiff_can_not_see_through_is_told_so():
    report = check_technique(Bisection())
    assert not report
    assert "autodiff finds no gradient through a bisection" in str(report)


class Narrow(Inversion):
    """Uniform on a few float32 numbers around 1/2: what lies a thousandth of its width outside rounds onto its end."""

    width: float = 1e-6
    bounded: bool = True

    @property
    def support(self):
        return 0.5 - self.width / 2, 0.5 + self.width / 2

    def quantile(self, u):
        return 0.5 + self.width * (u - 0.5)

    def cdf(self, x):
        return below_one((x - 0.5) / self.width + 0.5)

    def log_prob(self, x):
        log_p = 0 * x - jnp.log(self.width)
        return within(x, log_p, *self.support) if self.bounded else log_p


@pytest.mark.parametrize("bounded", [True, False])
def test_outside_of_a_support_is_no_rounding_of_its_ends(bounded):
    assert bool(check_technique(Narrow(bounded=bounded), points=256)) == bounded
