"""The matrix of a technique change is that of the probabilities with which techniques are proposed."""

import jax
import jax.numpy as jnp
import numpy as np

import mcmc1d
from mcmc1d.moves import TechniqueChange
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Ramp, Tent, Uniform

MATRIX = np.array([[0.2, 0.5, 0.3], [0.25, 0.0, 0.75], [0.6, 0.1, 0.3]])
TARGET = mcmc1d.Multiplexed(Sinusoid(0.9), (Tent(0.3), Ramp(1.2), Uniform()))


def test_each_technique_is_proposed_as_often_as_the_row_says():
    """By a grid of 1000 numbers: to a number."""
    draw = TechniqueChange(MATRIX).proposals.draw
    numbers = jnp.asarray((np.arange(1000) + 0.5) / 1000)
    for i, row in enumerate(MATRIX):
        j, back, log_t = (np.asarray(part) for part in jax.vmap(lambda w, i=i: draw(TARGET, i, w))(numbers))
        np.testing.assert_allclose(np.bincount(j, minlength=3) / 1000, row, atol=1.1e-3)
        with np.errstate(divide="ignore"):
            np.testing.assert_allclose(log_t, np.log(MATRIX[j, i] / MATRIX[i, j]), rtol=1e-5)
        possible = np.isfinite(log_t)
        again = jax.vmap(lambda j, w: draw(TARGET, j, w)[0])(jnp.asarray(j), jnp.asarray(back))
        assert (np.asarray(again)[possible] == i).all()
