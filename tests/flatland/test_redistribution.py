"""Energy redistribution in the plane, pixel by pixel.

False-alarm rate 1e-5 for each image, over its pixels; what it would have caught is asserted with it.
"""

import jax
import numpy as np
import pytest
from scipy.stats import norm

from mcmc1d.flatland.integrators import EnergyRedistribution, Image, redistribution
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import scene

pytestmark = pytest.mark.slow

ALARM = 1e-5


def test_redistributed_energy_meets_every_pixel_of_the_box(monkeypatch):
    """Of two edges. Detectable: 10 % of a pixel, or of the mean; by the normal law 5 %.

    A path starts a quarter of a chain on average, by chance. Twin: the number of chains is rounded instead.
    """
    box = scene("box").with_pixels(4)
    exact = image(box, 2)
    method = EnergyRedistribution(length=16, mutations=4.0)

    def rendered():
        return Image([method.render(jax.random.key(2), box, 2, 2**21)])

    def held(found):
        return compare(found, exact.values[1:], exact.errors[1:], level=ALARM)

    found = rendered()
    result = held(found)
    assert result.agrees, result.excess
    assert result.detectable.max() < 0.1, result.detectable
    limit = norm.isf(ALARM / 2 / 4)  # the same by the normal law, which finds smaller errors
    assert np.abs((found.values - exact.values[1:]) / found.errors).max() < limit
    relative = found.errors / np.maximum(exact.values[1:], exact.values[1:].mean())
    assert (limit + norm.isf(0.01)) * relative.max() < 0.05, relative
    monkeypatch.setattr(redistribution, "chains_of", lambda energy, quantum, xi: np.rint(energy / quantum).astype(int))
    assert not held(rendered()).agrees


def test_errors_say_what_is_wrong():
    with pytest.raises(ValueError, match="EnergyRedistribution: length must be a whole number, 1 at least, not 0"):
        EnergyRedistribution(length=0)
    with pytest.raises(ValueError, match="EnergyRedistribution: mutations must be positive and finite"):
        EnergyRedistribution(mutations=0.0)
