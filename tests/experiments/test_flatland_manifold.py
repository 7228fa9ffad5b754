"""What is said of manifold steps: each verdict on data made up to have it."""

import numpy as np
import pytest
import xarray as xr

from experiments.flatland_manifold import METHODS, TWIN, judge

SCENES, RUNS, PIXELS = ["one", "two"], 64, 4


def made_up(levels=(1.0, 0.5, 4.0, 0.6), noise=0.3, off=0.0, wrong=20.0):
    """Squared errors by method; `off`: of images from the exact one, in standard errors, and `wrong`: of the twin."""
    rng = np.random.default_rng(0)
    level = np.array([*levels, 1.0])[:, None, None]
    shape = len(SCENES), len(levels) + 1, 1, RUNS
    bias = np.zeros((len(SCENES), len(levels) + 1, PIXELS))
    bias[:, :-1, 0], bias[0, -1, 1] = 0.01 * off, 0.01 * wrong
    return xr.Dataset(
        {
            "mse": (("scene", "method", "budget", "run"), level * np.exp(noise * rng.standard_normal(shape))),
            "bias": (("scene", "method", "pixel"), bias),
            "bias_error": (("scene", "method", "pixel"), np.full_like(bias, 0.01)),
            "reference_error": (("scene", "pixel"), np.zeros((len(SCENES), PIXELS))),
        },
        {"scene": SCENES, "method": [*METHODS, TWIN], "budget": [2**16]},
    )


def verdicts(**options):
    return {claim.id.removeprefix("plane."): claim.verdict for claim in judge(made_up(**options))}


def test_what_is_clear_holds():
    assert set(verdicts().values()) == {"holds"}


@pytest.mark.parametrize(
    ("options", "name", "verdict"),
    [
        ({"off": 8.0}, "manifold-exact", "fails"),
        ({"wrong": 1.0}, "manifold-exact", "open"),  # the twin is not seen
        ({"levels": (1, 1, 1, 4)}, "manifold-mlt", "fails"),
        ({"levels": (1, 1, 1, 1)}, "manifold-mlt", "open"),
        ({"levels": (4, 1, 1, 1)}, "mmlt-against-mlt-manifold", "fails"),
        ({"levels": (1, 1, 1, 1)}, "mmlt-against-mlt-manifold", "open"),
        ({"levels": (1, 1, 1, 4)}, "manifold-against-mmlt", "fails"),
        ({"levels": (1, 1, 1, 1)}, "manifold-against-mmlt", "open"),
        ({"levels": (1, 4, 1, 1)}, "mmlt-manifold", "fails"),
        ({"levels": (1, 1, 1, 1)}, "mmlt-manifold", "open"),
    ],
)
def test_what_is_not_fails_or_is_open(options, name, verdict):
    assert verdicts(**options)[name] == verdict
