"""Replica exchange over the techniques of bidirectional path tracing, pixel by pixel.

False-alarm rate 1e-5 for each image, over its pixels; what it would have caught is asserted with it.
"""

import jax
import numpy as np
import pytest

from mcmc1d.flatland.integrators import Image, ReplicaExchange, Stacked
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import scene

pytestmark = pytest.mark.slow


def test_each_class_adds_its_part_to_every_pixel_of_the_box():
    """Of two edges. Detectable: 30 % of a pixel, or of the mean. Twin: a class is left out."""
    box = scene("box").with_pixels(4)
    exact = image(box, 2)
    layer = ReplicaExchange().render(jax.random.key(1), box, 2, 2**19)
    assert isinstance(layer, Stacked)

    def agrees(layers):
        return compare(Image([Stacked(tuple(layers))]), exact.values[1:], exact.errors[1:], level=1e-5)

    result = agrees(layer.layers)
    assert result.agrees, result.excess
    assert result.detectable.max() < 0.3, result.detectable
    largest = int(np.argmax([part.value.mean() for part in layer.layers]))
    assert not agrees([part for k, part in enumerate(layer.layers) if k != largest]).agrees


def test_a_dark_length_is_dark():
    door = scene("door").with_pixels(4)
    layer = ReplicaExchange(chains=64).render(jax.random.key(0), door, 1, 2**10)
    assert not layer.value.any()
    assert layer.rays > 0
