"""Verdicts of MMLT's figures in the plane, of made-up errors: each can be had, and its twin fails."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from experiments import flatland_mmlt, flatland_regions
from experiments.support.flatland_chains import Placed
from experiments.support.flatland_equal import WHOLE, critical, mean_ratio, root, squared
from experiments.support.flatland_glossy import GLOSSY_DOOR, glossy_door, marked
from experiments.support.flatland_rivals import CHAINS, INTEGRATORS
from mcmc1d.flatland.scenes import scene

RUNS, PIXELS, TECHNIQUES = 100, 4, 3
SHARES = np.array([0.6, 0.3, 0.1])


def made_up(scenes=("door", GLOSSY_DOOR), parts=(WHOLE,), spread=0.3, blur=0.01, worse=None) -> xr.Dataset:
    """Squared errors of mean 1 with a relative spread, `worse` times that of some; images without an error."""
    rng = np.random.default_rng(0)
    shape = len(scenes), 1, len(INTEGRATORS), 2, len(parts), RUNS
    each = (1 + spread * rng.choice([-1.0, 1.0], shape)) / np.array([1.0, 4.0])[:, None, None]
    data = xr.Dataset(
        {
            "mse": (("scene", "edges", "integrator", "budget", "part", "run"), each),
            "reference": (("scene", "edges", "pixel"), np.full((len(scenes), 1, PIXELS), 1.0)),
            "reference_error": (("scene", "edges", "pixel"), np.zeros((len(scenes), 1, PIXELS))),
            "member": (("scene", "part", "pixel"), np.ones((len(scenes), len(parts), PIXELS), bool)),
            "rays": (("edges", "budget"), np.array([[1000, 4000]])),
            "runs": RUNS,
            "spent_on_b": 0.2,
        },
        {"scene": list(scenes), "edges": [4], "integrator": list(INTEGRATORS), "part": list(parts)},
    )
    ones = xr.ones_like(data.mse.isel(budget=0, part=0, run=0, drop=True))
    data = data.assign(
        value=ones * data.reference,
        error=blur * ones * data.reference,
        mean_error=0.3 * blur * ones,
        scale=xr.where(data.integrator == "PSSMLT, max", 0.7, ones),
        b_cost=0 * ones,
        contribution=("technique", SHARES),
        contribution_error=("technique", 0.001 * np.ones(TECHNIQUES)),
        usage=("technique", SHARES + 0.001),
        usage_error=("technique", 0.01 * np.ones(TECHNIQUES)),
        effective=("chain", np.array([0.1, 0.1, 0.1, 0.2, 0.1])),
        effective_error=("chain", 0.001 * np.ones(len(CHAINS))),
    )
    for name in ("contribution", "contribution_error", "usage", "usage_error", "effective", "effective_error"):
        data[name] = data[name].expand_dims({"scene": list(scenes), "edges": [4]})
    for who, part, by in worse or ():
        here = {"integrator": who} | ({"part": part} if part else {})
        data.mse.loc[here] = by * data.mse.loc[here]
    return data.copy(deep=True)


def verdicts(module, data):
    return {claim.id.removeprefix("plane."): claim for claim in module.judge(data)}


def test_exact_holds_where_images_are_sharp_and_sees_the_wrong_scale():
    claim = verdicts(flatland_mmlt, made_up())["mmlt-exact"]
    assert claim.verdict == "holds"
    assert "times b is 143 off" in claim.number
    assert "worst pixel" in claim.tolerance


def test_exact_is_open_where_a_pixel_is_blurred():
    assert verdicts(flatland_mmlt, made_up(blur=0.05))["mmlt-exact"].verdict == "open"


@pytest.mark.parametrize("blur", [0.01, 0.05])
def test_exact_fails_where_one_pixel_is_off(blur):
    data = made_up(blur=blur)
    data.value.loc[{"scene": "door", "integrator": "MLT", "pixel": 2}] = 1.4
    assert verdicts(flatland_mmlt, data)["mmlt-exact"].verdict == "fails"


def test_exact_fails_where_the_scale_is_off_by_less_than_a_pixel_shows():
    data = made_up()
    data.value.loc[{"scene": "door", "integrator": "MMLT"}] = 1.03
    assert verdicts(flatland_mmlt, data)["mmlt-exact"].verdict == "fails"


def test_usage_follows_contribution_or_fails_or_is_open():
    data = made_up()
    assert verdicts(flatland_mmlt, data)["mmlt-usage"].verdict == "holds"
    wrong = data.assign(usage=xr.full_like(data.usage, 1 / TECHNIQUES))
    assert verdicts(flatland_mmlt, wrong)["mmlt-usage"].verdict == "fails"
    blind = data.assign(usage_error=xr.full_like(data.usage_error, 0.2))
    assert verdicts(flatland_mmlt, blind)["mmlt-usage"].verdict == "open"


@pytest.mark.parametrize(
    ("ratio", "error", "word"), [(0.2, 0.001, "holds"), (0.05, 0.001, "fails"), (0.2, 0.1, "open")]
)
def test_effective_paths_are_compared_with_their_noise(ratio, error, word):
    data = made_up()
    data.effective[..., CHAINS.index("MMLT")] = ratio
    data["effective_error"] = xr.full_like(data.effective_error, error)
    assert verdicts(flatland_mmlt, data)["mmlt-effective-paths"].verdict == word


@pytest.mark.parametrize(("by", "word"), [(4.0, "holds"), (0.25, "fails"), (1.01, "open")])
def test_a_rivalry_is_decided_either_way_or_not_at_all(by, word):
    claim = verdicts(flatland_mmlt, made_up(worse=[("PSSMLT, max", None, by)]))["mmlt-against-pssmlt"]
    assert claim.verdict == word
    assert claim.expected == "fails"  # what the plane has shown, against the paper


def test_a_rivalry_says_where_it_holds_and_what_is_beside():
    data = made_up(("door", GLOSSY_DOOR, "mirror_caustic"), worse=[("MLT", None, 4.0)])
    claims = verdicts(flatland_mmlt, data)
    assert claims["mmlt-against-mlt-door"].verdict == "fails"
    assert claims["mmlt-against-mlt"].verdict == "holds"
    assert "mirror_caustic (beside)" in claims["mmlt-against-mlt"].number
    data.mse.loc[{"scene": "door", "integrator": "PSSMLT, max"}] *= 4
    data.mse.loc[{"scene": GLOSSY_DOOR, "integrator": "PSSMLT, max"}] /= 4
    assert verdicts(flatland_mmlt, data)["mmlt-against-pssmlt"].verdict == "holds if the scene is door"


def test_a_rivalry_of_no_scene_is_no_claim():
    assert "mmlt-against-mlt-door" not in verdicts(flatland_mmlt, made_up((GLOSSY_DOOR,)))


REGIONS = (WHOLE, "glossy", "diffuse")


@pytest.mark.parametrize(
    ("worse", "words"),
    [
        ([("MLT", "glossy", 9.0)], ("holds", "holds", "holds")),
        ([("MMLT", "glossy", 9.0)], ("fails", "holds", "fails")),
        ([("MMLT", "diffuse", 9.0)], ("open", "fails", "fails")),
        ([], ("open", "holds", "open")),
    ],
)
def test_parts_are_compared(worse, words):
    claims = verdicts(flatland_regions, made_up((GLOSSY_DOOR,), REGIONS, worse=worse))
    ids = "mmlt-glossy-pixels", "mmlt-diffuse-pixels", "mmlt-uniform"
    assert tuple(claims[name].verdict for name in ids) == words


def test_comparable_is_open_where_noise_is_wide():
    claims = verdicts(
        flatland_regions, made_up((GLOSSY_DOOR,), REGIONS, spread=0.9999, worse=[("MLT", "diffuse", 1.9)])
    )
    assert claims["mmlt-diffuse-pixels"].verdict == "open"


def test_errors_are_compared_at_equal_rays():
    """Of r rays a chain has 0.8 r, and of b its cost over the others; independent integrators have all of them."""
    data = made_up().isel(scene=0)
    data["b_cost"] = xr.full_like(data.b_cost, 700.0)
    rays, known = squared(data, b_known=True)
    assert np.array_equal(rays, [1000, 4000])
    all_rays, total = squared(data)
    assert np.allclose(all_rays, rays / 0.8)
    assert np.allclose(total.sel(integrator="BDPT"), 0.8 * known.sel(integrator="BDPT"))
    assert np.allclose(total.sel(integrator="MMLT"), known.sel(integrator="MMLT") + (700 / (0.2 * all_rays))[:, None])


def test_intervals_of_mean_squares_cover():
    """Means of 100 exponential numbers and of 100 squares: 95 % of 2000 intervals, to 6 s.e.; half as wide do not."""
    rng = np.random.default_rng(3)
    above, below = rng.exponential(4.0, (2000, RUNS)), rng.standard_normal((2000, RUNS)) ** 2
    found = np.array([mean_ratio(a, b) for a, b in zip(above, below, strict=True)])
    narrow = found[:, :1] * (found / found[:, :1]) ** 0.5
    covers = [((one[:, 1] < 2) & (one[:, 2] > 2)).mean() for one in (found, narrow)]
    assert abs(covers[0] - 0.95) < 0.03
    assert covers[1] < 0.8
    middle, low, high = root(above)
    assert abs(((low < 2) & (high > 2)).mean() - 0.95) < 0.03
    assert np.all((low < middle) & (middle < high))


def test_the_critical_value_is_student_s_of_all_tests():
    data = made_up()
    assert critical(data, 1) == pytest.approx(4.05, abs=0.01)
    assert critical(data, 100) > critical(data, 1)


def test_samples_of_pssmlt_are_counted_lit_or_not_and_on_the_film_only():
    """Two techniques and three chains: current u with 1 - a, proposed with a; what is not seen, at film 0, is left."""
    paths: Any = SimpleNamespace(
        sensor=SimpleNamespace(pixels=4), film=lambda x: x[0], pixel=lambda x: (4 * x[0]).astype(jnp.int32)
    )
    film = jnp.array([[0.1, 0.3, 0.6], [0.1, 0.1, 0.0], [0.9, 0.3, 0.6], [0.1, 0.9, 0.9]])
    index = jnp.array([[0] * 3, [1] * 3] * 2, jnp.int32)
    steps: Any = SimpleNamespace(
        deposits=SimpleNamespace(x=film[:, None], index=index),
        info=SimpleNamespace(acceptance=jnp.array([[0.25, 0.5, 0.0]])),
    )
    counted = np.asarray(Placed(paths, 2).update(jnp.zeros((2, 4)), steps))
    assert np.allclose(counted, [[0.75, 1.0, 1.0, 0.25], [0.75 + 0.25 + 0.5, 0.0, 0.0, 0.5]])


def test_the_glossy_door_is_the_door_with_two_glossy_walls():
    door, glossy = scene("door"), glossy_door()
    assert np.array_equal(door.ends, glossy.ends)
    assert sum(segment.material.glossy > 0 for segment in glossy.segments) == 2
    parts = marked(glossy.with_pixels(16))
    assert not (parts["glossy"] & parts["diffuse"]).any()
    assert parts["glossy"].nonzero()[0].tolist() == [14, 15]
    with pytest.raises(ValueError, match="no pixel of scene door sees glossy walls alone"):
        marked(door)
