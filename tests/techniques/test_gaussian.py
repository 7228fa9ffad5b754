"""Box-Muller beside its contract: what it may not be given, and that its two samples are two."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

from mcmc1d.moves.scaled import ScaledStep
from mcmc1d.techniques.gaussian import BoxMuller
from mcmc1d.verify.goodness import p_value


def test_two_numbers_make_two_independent_normal_ones():
    """At level 1e-6; 2^14 draws show a CDF gap of 0.03. The twin, the second a copy of the first, is seen."""
    u = np.random.default_rng(0).random((2**14, 2)).astype(np.float32)
    x = np.asarray(jax.vmap(BoxMuller((0.5, -1.0), 2.0).forward)(jnp.asarray(u))[0], np.float64)
    place = np.minimum((8 * ndtr((x - [0.5, -1.0]) / 2.0)).astype(int), 7)
    counts = np.zeros((2, 64), int)
    np.add.at(counts[0], 8 * place[:, 0] + place[:, 1], 1)
    np.add.at(counts[1], 9 * place[:, 0], 1)
    assert p_value(counts[0], np.ones(64)) > 1e-6
    assert p_value(counts[1], np.ones(64)) < 1e-6


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BoxMuller((0.0, 0.0, 0.0)), "a point of the plane"),
        (lambda: BoxMuller(sigma=-1.0), "sigma must be positive"),
        (lambda: ScaledStep(0.0), "sigma must be positive"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()
