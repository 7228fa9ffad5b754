"""Instant radiosity: with a clamp too dark by what is predicted, exact together with that, and without one unbounded.

False-alarm rate 1e-5 for each test, over its pixels; what each would have caught is asserted with it.
"""

import jax
import numpy as np
import pytest
from scipy.stats import norm, t

from mcmc1d.flatland import Material, Pinhole, Scene, Segment
from mcmc1d.flatland.integrators import Image, InstantRadiosity, Stacked
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import scene

pytestmark = pytest.mark.slow

ALARM = 1e-5


@pytest.mark.parametrize(("name", "edges", "clamp", "detectable"), [("furnace", 2, 0.4, 0.05), ("box", 3, 0.25, 0.15)])
def test_what_it_makes_and_what_it_leaves_out_are_the_exact_image(name, edges, clamp, detectable):
    """Detectable: as given; by the normal law 4 % of the mean. Twins: the clamped image alone; with twice its clamp."""
    of = scene(name).with_pixels(4)
    exact, method = image(of, edges), InstantRadiosity(cameras=8, clamp=clamp)
    made, lost = method.render(jax.random.key(0), of, edges, 2**19), method.bias(jax.random.key(1), of, edges, 2**18)
    known = exact.values[-1:], exact.errors[-1:]
    result = compare(Image([Stacked((made, lost))]), *known, level=ALARM)
    assert result.agrees, result.excess
    assert result.detectable.max() < detectable, result.detectable
    assert not compare(Image([made]), *known, level=ALARM).agrees
    less = InstantRadiosity(cameras=8, clamp=2 * clamp).bias(jax.random.key(1), of, edges, 2**18)
    assert not compare(Image([Stacked((made, less))]), *known, level=ALARM).agrees
    both = Stacked((made, lost))  # the same by the normal law, which finds smaller errors
    limit = norm.isf(ALARM / 2 / 4)
    assert np.abs((both.value - exact.values[-1]) / both.error).max() < limit
    assert (limit + norm.isf(0.01)) * both.error.max() < 0.04 * exact.values[-1].mean()


def corner():
    """A lamp of length 2 that meets a white floor in a corner; each point of the floor is as likely to be looked at."""
    segments = Segment((0, 0), (2, 0), Material(lambert=1)), Segment((0, 2), (0, 0), Material(emission=1))
    return Scene("corner", segments, Pinhole((1, 1), (0, -1), float(np.arctan(1.25)), 1))


def test_the_variance_grows_with_the_logarithm_of_the_clamp_and_so_has_no_bound():
    """Next to the corner G = sin cos / r, over which the second moment is the integral of (pi / 16) dr / r.

    With f_r L_e l = 1, and densities of 1 / 2.5 on the floor and 1 / 2 on the lamp, it rises by pi / 80 for each factor
    e: exactly, once the clamp cuts off a quarter disc that lies within both. Detectable: a rise off by a quarter.
    """
    rises = []
    for seed in range(16):
        moments = []
        for clamp in (1.0, 16.0):
            sums = InstantRadiosity(cameras=1, clamp=clamp).render(jax.random.key(seed), corner(), 2, 2**17).deposits
            moments.append(sums.squares[0] / sums.size)
        rises.append(moments[1] - moments[0])
    predicted = np.pi / 80 * np.log(16)
    error = np.std(rises, ddof=1) / 4
    limit = t.isf(ALARM / 2, 15)
    assert abs(np.mean(rises) - predicted) < limit * error
    assert (limit + t.isf(0.01, 15)) * error < 0.25 * predicted
    assert abs(np.mean(rises)) > limit * error  # a variance with a bound would not rise
    unclamped = InstantRadiosity(cameras=1).render(jax.random.key(0), corner(), 2, 2**10)
    assert np.isinf(unclamped.deposits.bound)
    assert np.isinf(compare(Image([unclamped]), unclamped.value[None]).detectable).all()


def test_a_caustic_is_an_error_or_left_out():
    """Of three edges in the furnace, some of whose walls' light comes by mirrors."""
    furnace = scene("furnace").with_pixels(2)
    with pytest.raises(ValueError, match=r"scene furnace: of the light of 3 edges, \d+% comes by way of a mirror"):
        InstantRadiosity().check(furnace, 3)
    InstantRadiosity(partial=True).check(furnace, 3)
    InstantRadiosity().check(furnace, 1)


def test_errors_say_what_is_missing():
    with pytest.raises(ValueError, match="clamp must be positive"):
        InstantRadiosity(clamp=0.0)
    with pytest.raises(ValueError, match="cameras must be a whole number, 1 at least"):
        InstantRadiosity(cameras=0)
