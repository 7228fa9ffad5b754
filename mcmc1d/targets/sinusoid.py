"""The sinusoid of Bitterli et al. 2017, section 7.1."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_positive, rising
from mcmc1d.examples import Examples
from mcmc1d.numerics import is_concrete, number
from mcmc1d.special import sin_turns
from mcmc1d.targets.base import Target
from mcmc1d.types import Scalar


class Sinusoid(Target):
    """f(x) = scale (1 + amplitude sin(2 pi (frequency x + phase))) on [0, 1], the phase in turns."""

    amplitude: Scalar = eqx.field(converter=number, default=0.9)
    frequency: Scalar = eqx.field(converter=number, default=2.0)
    phase: Scalar = eqx.field(converter=number, default=0.0)
    scale: Scalar = eqx.field(converter=number, default=1.0)

    def __check_init__(self):
        require_positive(self, scale=self.scale, frequency=self.frequency)
        if is_concrete(self.amplitude):
            require(
                bool(np.abs(self.amplitude) <= 1),
                f"Sinusoid: an amplitude of {self.amplitude} makes the target negative; keep it in [-1, 1]",
            )

    def log_f(self, x: Scalar) -> Scalar:
        turns = self.frequency * x + self.phase
        inside = (x >= 0) & (x <= 1)
        wave = 1 + self.amplitude * sin_turns(turns)  # with an amplitude of 1, under zero by a rounding
        return jnp.log(jnp.where(inside & (wave > 0), self.scale * wave, 0))

    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        a, n, phase, scale = (float(v) for v in (self.amplitude, self.frequency, self.phase, self.scale))
        x = np.clip(rising(edges, "Sinusoid.bin_masses"), 0, 1)
        left, width = x[:-1], np.diff(x)
        # The difference of two cosines as a product, so that narrow bins keep their accuracy.
        wave = np.sin(np.pi * (n * (2 * left + width) + 2 * phase)) * np.sin(np.pi * n * width)
        return scale * (width + a * wave / (np.pi * n))


EXAMPLES = Examples(lambda: {"sinusoid": Sinusoid(), "sinusoid_zeros": Sinusoid(-1.0, 1.5, 0.1, 3.0)})
