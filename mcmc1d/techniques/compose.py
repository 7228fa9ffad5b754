"""One technique after another: the sample of the first is the primary sample of the next."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_instance
from mcmc1d.examples import Examples
from mcmc1d.numerics import below_one, cast, is_concrete
from mcmc1d.techniques.base import Forward, Inverse, Technique, checked_shape, dim_v, sample_shape
from mcmc1d.types import Array, Corners, Float, Scalar


class Compose(Technique):
    """x = S_n(... S_2(S_1(u))): a warp of a technique on the unit cube by further ones.

    Only the first may forget numbers: p(x) is p_1(x_1) p_2(x_2) ... at the intermediate samples, which are unknown
    where a later technique has a v of its own.
    """

    techniques: tuple[Technique, ...]

    def __init__(self, techniques: Sequence[Technique]):
        """`techniques`: in the order in which they are applied; all but the last make samples in the unit cube."""
        self.techniques = tuple(techniques)
        require(len(self.techniques) > 0, "Compose: give one technique at least")
        for technique in self.techniques:
            checked_shape(require_instance(technique, Technique, "Compose: a technique"))
        for before, after in zip(self.techniques, self.techniques[1:], strict=False):
            low, high = (np.asarray(corner) for corner in before.support) if is_concrete(before) else (0, 1)
            require(
                bool(np.all(low >= -1e-6) and np.all(high <= 1 + 1e-6)),
                f"Compose: {type(before).__name__} makes samples from {low} to {high}, and all but the last must make "
                "them in the unit cube",
            )
            name, shape = type(after).__name__, sample_shape(before)
            require(
                dim_v(after) == 0,
                f"Compose: {name} forgets {dim_v(after)} of its numbers; only the first technique may",
            )
            require(
                after.dim_u == max(1, sum(shape)) and len(shape) <= 1,
                f"Compose: {name} reads {after.dim_u} numbers, {type(before).__name__} makes a sample of shape {shape}",
            )

    @property
    def dim_u(self) -> int:
        """As many numbers as the first technique reads."""
        return self.techniques[0].dim_u

    @property
    def support(self) -> Corners:
        return self.techniques[-1].support

    @property
    def breaks(self) -> tuple[float, ...]:
        """The breaks of every technique, carried through the later ones."""
        points: list[float] = []
        with jax.enable_x64(True):
            for technique in cast(self.techniques, jnp.float64):
                if sample_shape(technique) == ():
                    points = [float(technique.forward(jnp.asarray([point]))[0]) for point in points]
                points += technique.breaks
        return tuple(sorted(set(points)))

    def forward(self, u: Float[Array, " m"]) -> Forward:
        x, v, log_det = self.techniques[0].forward(u)
        for technique in self.techniques[1:]:
            x, _, more = technique.forward(below_one(jnp.atleast_1d(x)))
            log_det = log_det + more
        return x, v, log_det

    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        log_det = jnp.zeros((), jnp.asarray(x).dtype)
        for technique, before in zip(self.techniques[:0:-1], self.techniques[-2::-1], strict=True):
            u, more = technique.inverse(x, v[:0])
            log_det, x = log_det + more, u.reshape(sample_shape(before))
        u, more = self.techniques[0].inverse(x, v)
        return u, log_det + more

    def log_prob(self, x: Float[Array, "..."]) -> Scalar:
        log_p = jnp.zeros((), jnp.asarray(x).dtype)
        for technique, before in zip(self.techniques[:0:-1], self.techniques[-2::-1], strict=True):
            log_p = log_p + technique.log_prob(x)
            x = technique.inverse(x, jnp.zeros((0,)))[0].reshape(sample_shape(before))
        return log_p + self.techniques[0].log_prob(x)


def _examples() -> dict[str, Technique]:
    from mcmc1d.techniques.elementary import Ramp, Tent
    from mcmc1d.techniques.mixture import EXAMPLES as MIXTURES
    from mcmc1d.techniques.piecewise import PiecewiseLinear

    return {
        "compose": Compose((Tent(0.4), Ramp(1.2))),
        "compose_three": Compose((Ramp(1.0), PiecewiseLinear([0, 0.5, 1], [1, 3, 2]), Ramp(-1.5))),
        "compose_after_mixture": Compose((MIXTURES["mixture"], Ramp(1.0))),
    }


EXAMPLES = Examples(_examples)
