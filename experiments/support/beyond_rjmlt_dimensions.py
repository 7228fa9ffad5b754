"""The jumps between dimensions of `beyond_rjmlt`: the line and the square as one plane."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import rising
from mcmc1d.moves import LargeStep, Mixture, Move, Proposal, SmallStep, TechniqueChange
from mcmc1d.numerics import pick
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import PiecewiseLinear as Linear
from mcmc1d.targets import Sinusoid, Target
from mcmc1d.techniques import Ramp, Technique, within
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.types import Array, Corners, Float, Scalar


class LineAndSquare(Target):
    """A density on the line (x in [0, 1]) and one on the square, disjoint, padded to one dimension.

    z = (x, spare) with the spare number uniform is the line, z = (1 + x, y) the square: counting measure on the two,
    times Lebesgue's, which on the line counts the spare number as well.
    """

    on_line: Target = Sinusoid(0.9, 1.5, 0.1, 1.0)
    along: tuple[Target, Target] = (Linear([0, 0.3, 1], [0.2, 2.0, 0.3]), Sinusoid(0.8, 1.0, 0.3, 1.0))
    across: tuple[Target, Target] = (Linear([0, 0.6, 1], [3.0, 0.3, 0.6]), Linear([0, 0.4, 1], [0.1, 0.4, 2.4]))

    @property
    def domain(self) -> Corners:
        return np.zeros(2), np.array([2.0, 1.0])

    def log_f(self, x: Float[Array, " 2"]) -> Scalar:
        terms = [a.log_f(x[0] - 1) + b.log_f(x[1]) for a, b in zip(self.along, self.across, strict=True)]
        inside = (x[0] >= 0) & (x[0] < 2) & (x[1] >= 0) & (x[1] <= 1)
        log_f = jnp.where(x[0] < 1, self.on_line.log_f(x[0]), jnp.logaddexp(*terms))
        return jnp.where(inside, log_f, -jnp.inf)

    def bin_masses(self, edges: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        x, y = (rising(e, "LineAndSquare.bin_masses") for e in edges)
        line = np.outer(self.on_line.bin_masses(x), np.diff(np.clip(y, 0, 1)))
        products = zip(self.along, self.across, strict=True)
        return line + sum(np.outer(a.bin_masses(x - 1), b.bin_masses(y)) for a, b in products)

    @property
    def cells(self) -> np.ndarray:
        """The masses of quarters of the line and of the square, by x and by y (or the spare number): (8, 4)."""
        masses = self.bin_masses((np.linspace(0, 2, 9), np.linspace(0, 1, 5)))
        return masses / masses.sum()


class RampPair(Technique):
    """z = (start + x, y): x from a ramp, y from one of slope `tilt` (2 x - 1): without tilt the spare number.

    So the line reads one number and the square two, and both are bijections of the unit square.
    """

    start: float = eqx.field(static=True)
    slope: float = eqx.field(static=True)
    tilt: float = eqx.field(static=True)

    @property
    def dim_u(self) -> int:
        return 2

    @property
    def support(self) -> Corners:
        return np.array([self.start, 0.0]), np.array([self.start + 1.0, 1.0])

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        x = Ramp(self.slope).quantile(u[0])
        z = jnp.stack([self.start + x, self._second(x).quantile(u[1])])
        return z, u[2:], -self.log_prob(z)

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        place = x[0] - self.start
        u = jnp.stack([Ramp(self.slope).cdf(place), self._second(place).cdf(x[1])])
        return jnp.clip(u, 0, 1 - jnp.finfo(u.dtype).epsneg), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        place = x[0] - self.start
        log_p = Ramp(self.slope).log_prob(place) + self._second(place).log_prob(x[1])
        return within(
            place, log_p, 0, 1 if self.start else jnp.nextafter(jnp.ones((), x.dtype), jnp.zeros((), x.dtype))
        )

    def _second(self, x: Scalar) -> Ramp:
        return Ramp(self.tilt * (2 * jnp.asarray(x) - 1))


TRANSDIMENSIONAL = Multiplexed(LineAndSquare(), (RampPair(0.0, 1.6, 0.0), RampPair(1.0, -1.4, 1.8)))


class DimensionJump(Move):
    """From the line to the square and back, x kept: y is the quantile of the spare number in a ramp, and the reverse.

    Green 1995, with the spare number as the one that matches the dimensions. The log-determinant is that of y with
    respect to the spare number, between those of the techniques; the mistake leaves it out.
    """

    slope: float = eqx.field(static=True, default=1.7)
    mistake: bool = eqx.field(static=True, default=False)

    def dim_w(self, target: Multiplexed) -> int:
        return 0

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 0"]) -> Proposal:
        here, ramp = state.seen, Ramp(self.slope)
        up, second = state.index == 0, here.x[1]
        x = jnp.where(up, here.x[0] + 1, here.x[0] - 1)
        other = jnp.where(up, ramp.quantile(second), ramp.cdf(second))
        stretch = jnp.where(up, -ramp.log_prob(other), ramp.log_prob(second))
        there = 1 - jnp.asarray(state.index)
        u, log_det = target.inverse(there, jnp.stack([x, other]), here.v)
        log_det = log_det + here.log_det + jnp.where(self.mistake, 0, stretch)
        return Proposal(State(there, u), w, log_det)


class JumpWithoutJacobian(Move):
    """The technique change at fixed u, its ratio taken as that of f: the densities p, its Jacobian in x, left out."""

    def dim_w(self, target: Multiplexed) -> int:
        return 1

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Proposal:
        plain = TechniqueChange().propose(target, state, w)
        there = target.evaluate(plain.state)
        log_p = pick(there.seen.log_p, there.index) - pick(state.seen.log_p, state.index)
        return Proposal(there, plain.w, plain.log_det + log_p)


def kernels() -> dict[str, Move]:
    """Each jump among steps within a dimension."""
    jumps = {
        "same numbers": TechniqueChange(),
        "same x": DimensionJump(),
        "same numbers, no p": JumpWithoutJacobian(),
        "same x, no stretch": DimensionJump(mistake=True),
    }
    return {
        name: Mixture({"small": (0.5, SmallStep(0.1)), "large": (0.1, LargeStep()), "jump": (0.4, jump)})
        for name, jump in jumps.items()
    }


RIGHT = ("same numbers", "same x")
