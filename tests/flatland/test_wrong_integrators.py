"""Every wrong integrator is caught by the layer that must catch it, and the same without its mistake passes.

The false-alarm rate is 1e-5 for each image; what is caught here is caught at a tenth of the samples of a real test.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.flatland.integrators import integrate
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.mutants import LAYERS, mutants
from mcmc1d.flatland.reference import image

pytestmark = pytest.mark.slow

KNOWN = mutants()
_EXACT, _RIGHT = {}, {}


def exact(of, lengths):
    if (of.name, lengths) not in _EXACT:
        found = image(of, max(lengths))
        rows = [k - 1 for k in lengths]
        _EXACT[of.name, lengths] = found.values[rows], found.errors[rows]
    return _EXACT[of.name, lengths]


def agrees(mutant, integrator):
    of = mutant.scene.with_pixels(4)
    found = integrate(jax.random.key(3), integrator, of, lengths=mutant.lengths, samples=mutant.samples)
    return compare(found, *exact(of, mutant.lengths)).agrees


@pytest.mark.parametrize("name", [name for name, mutant in KNOWN.items() if mutant.layer == "image"])
def test_the_exact_image_catches(name):
    mutant = KNOWN[name]
    twin = f"{mutant.right} {mutant.scene.name} {mutant.samples}"  # which several mutants have in common
    if twin not in _RIGHT:
        _RIGHT[twin] = agrees(mutant, mutant.right)
    assert _RIGHT[twin]
    assert not agrees(mutant, mutant.subject)


def comes_back(family):
    """Whether every technique's inverse leads back, in float64."""
    n = 300
    index = jnp.asarray(np.arange(n) % len(family.members), jnp.int32)
    with jax.enable_x64(True):
        u = jnp.asarray(np.random.default_rng(0).random((n, family.dim_u)))
        trip = jax.jit(jax.vmap(lambda i, u: family.inverse(i, *family.forward(i, u)[:2])[0]))(index, u)
        return bool(np.max(np.abs(trip - u)) < 1e-7)


@pytest.mark.parametrize("name", [name for name, mutant in KNOWN.items() if mutant.layer == "contract"])
def test_the_round_trip_catches(name):
    assert comes_back(KNOWN[name].right)
    assert not comes_back(KNOWN[name].subject)


def test_each_says_where_it_comes_from():
    assert len(KNOWN) >= 12
    for mutant in KNOWN.values():
        assert mutant.layer in LAYERS
        assert mutant.mistake
        assert mutant.origin
