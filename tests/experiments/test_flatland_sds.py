"""What is said of paths from mirror to wall to mirror: each verdict on data made up to have it; the blur."""

import numpy as np
import pytest
import xarray as xr

from experiments.flatland_sds import CHAINS, EDGES
from experiments.support.flatland_caustic import blurred, caustic, exact
from experiments.support.flatland_sds_claims import claims

WIDTHS, RADII, RUNS, PIXELS = [0.1, 0.001], [0.05, 0.2], 32, 8


def made_up(photons=0.1, mlt=0.5, noise=0.3, off=0.0, far=3.0, black=(0, 30), joined=0.0, direct=0.02):
    """Squared errors over MMLT's of photons and MLT, `direct`: of 3 edges over 4.

    `off`: of photons from their prediction, in standard errors.
    """
    rng = np.random.default_rng(0)
    shape = len(EDGES), len(WIDTHS), len(CHAINS), 1, RUNS
    level = np.array([1.0, mlt, mlt])[:, None, None]
    mse = level * np.exp(noise * rng.standard_normal(shape))
    of_photons = np.exp(noise * rng.standard_normal((len(EDGES), len(WIDTHS), len(RADII), 1, RUNS)))
    of_photons *= photons
    mse[0] *= direct
    b = np.ones((len(EDGES), len(WIDTHS), 1, RUNS))
    for k, runs in enumerate(black):
        b[1, k, 0, :runs] = 0
    contribution = np.zeros((len(EDGES), len(WIDTHS), 5))
    contribution[0, :, :4], contribution[1, :, 4], contribution[1, :, 2] = 1, 1, joined
    chance = 1 - np.maximum(np.array(black) / RUNS, 1e-9)
    predicted = np.ones((len(RADII), PIXELS))
    dims = "edges", "width"
    every = {
        "mse": ((*dims, "method", "budget", "run"), mse),
        "mse_known": ((*dims, "method", "budget", "run"), mse),
        "photon_mse": ((*dims, "radius", "budget", "run"), of_photons),
        "b": ((*dims, "budget", "run"), b),
        "size": ((*dims, "budget"), np.ones((len(EDGES), len(WIDTHS), 1))),
        "chance": (dims, np.stack([chance, chance])),
        "tried": (dims, np.full((len(EDGES), len(WIDTHS)), 1e5)),
        "contribution": ((*dims, "technique"), contribution),
        "reference": ((*dims, "pixel"), np.full((len(EDGES), len(WIDTHS), PIXELS), 1 - far * 0.1)),
        "reference_error": ((*dims, "pixel"), np.zeros((len(EDGES), len(WIDTHS), PIXELS))),
        "photons": (("radius", "pixel"), predicted + off * 0.01),
        "photons_error": (("radius", "pixel"), np.full((len(RADII), PIXELS), 0.01)),
        "predicted": (("radius", "pixel"), predicted),
        "of": 0.05,
        "middle": WIDTHS[0],
    }
    coords = {"edges": list(EDGES), "width": WIDTHS, "method": list(CHAINS), "radius": RADII, "budget": [2**16]}
    return xr.Dataset(every, coords)


def verdicts(**options):
    return {claim.id.removeprefix("plane."): claim.verdict for claim in claims(made_up(**options))}


def test_what_is_clear_holds():
    found = verdicts()
    assert found.pop("sds-seeds") == "holds if the scene is a lamp of 0.001"
    assert set(found.values()) == {"holds"}


@pytest.mark.parametrize(
    ("options", "name", "verdict"),
    [
        ({"joined": 1e-3}, "sds-not-joined", "fails"),
        ({"off": 6.0}, "sds-blur", "fails"),
        ({"far": 0.0}, "sds-blur", "open"),  # the image is not blurred, and nothing tells the twin
        ({"photons": 10.0}, "sds-photons", "fails"),
        ({"photons": 0.4, "noise": 3.0}, "sds-photons", "open"),
        ({"mlt": 3.0}, "sds-mlt", "fails"),
        ({"mlt": 1.0}, "sds-mlt", "open"),
        ({"direct": 1.0}, "sds-direct", "fails"),
        ({"direct": 0.1}, "sds-direct", "open"),
        ({"black": (0, 0)}, "sds-seeds", "fails"),
        ({"black": (0, 16)}, "sds-seeds", "fails"),
        ({"black": (16, 16)}, "sds-seeds", "open"),
    ],
)
def test_what_is_not_fails_or_is_open(options, name, verdict):
    assert verdicts(**options)[name] == verdict


def test_runs_that_find_paths_more_often_than_predicted_refute_it():
    data = made_up(black=(0, 0))
    data["chance"] = data.chance * 0 + 1e-9
    assert next(c for c in claims(data) if c.id == "plane.sds-seeds").verdict == "fails"


def test_a_kernel_of_photons_widens_the_exact_image():
    """Of no width it is the exact image, which shares no code with the closed form; the mirror stands to the right."""
    scene = caustic(0.1, 16)
    reference = exact(scene)
    for edges in EDGES:
        sharp, wide = blurred(scene, 1e-6, edges), blurred(scene, 0.2, edges)
        np.testing.assert_allclose(sharp, reference.values[edges - 1], atol=2e-4)
        assert np.abs(wide - sharp).max() > 0.02
        assert wide.max() < 0.95 * sharp.max()
    assert blurred(scene, 1e-6, 4).argmax() > blurred(scene, 1e-6, 3).argmax()
