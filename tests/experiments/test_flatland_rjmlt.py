"""The verdicts on RJMLT in the plane, from made-up measurements: each can come out as holding, failing and open."""

import numpy as np
import pytest
import xarray as xr

from experiments import flatland_rjmlt
from experiments.support.flatland_acceptance import SHOWN
from experiments.support.flatland_chains import METHODS
from experiments.support.flatland_stability import LOOKS, STATISTICS, compared

EDGES, SCENES, STEPS, RUNS = (2, 10), ("box", "door"), (64, 128, 256, 512, 1024), 40


def measured(**changes):
    """As the paper has it: small steps fall to 1 % where they change the technique, jumps are accepted."""
    uniform = np.array([0.6, 0.7])
    rate = {"keep": [0.8, 0.3], "change": [0.2, 0.01], "jump": [1.0, 1.0], "uniform jump": uniform}
    rate |= {name: value for name, value in changes.items() if name in SHOWN}
    rng = np.random.default_rng(0)
    squared = rng.gamma(2.0, size=(len(SCENES), len(METHODS), len(STEPS), RUNS))
    ratio = np.broadcast_to([0.5, 0.4, 0.6], (len(STATISTICS), len(METHODS) - 1, len(SCENES), len(LOOKS), 3)).copy()
    ratio[:, 0] = 2.0, 1.8, 2.2  # MMLT with any technique
    by_move, by_pixel = ("edges", "move"), ("scene", "method", "pixel")
    shape = len(SCENES), len(METHODS), 3
    data = xr.Dataset(
        {
            "acceptance": (by_move, np.array([rate[move] for move in SHOWN]).T),
            "acceptance_error": (by_move, np.full((2, 4), changes.get("error", 0.002))),
            "proposals": (by_move, np.full((2, 4), changes.get("count", 4000))),
            "predicted": ("edges", uniform + changes.get("off", 0.0)),
            "predicted_error": ("edges", [1e-4, 1e-4]),
            "squared": (("scene", "method", "mutations", "run"), squared),
            "rays": (("scene", "mutations"), np.tile(STEPS, (2, 1))),
            "spread": (by_pixel, np.full(shape, 0.3)),
            "excess": (by_pixel, np.full(shape, 0.5)),
            "twin": (by_pixel, np.full(shape, 3.0)),
            "detectable": (by_pixel, np.full(shape, 0.05)),
            "ratio": (("statistic", "rival", "scene", "look", "end"), ratio),
        },
        {
            "edges": list(EDGES),
            "move": list(SHOWN),
            "scene": list(SCENES),
            "method": list(METHODS),
            "rival": list(METHODS[1:]),
            "mutations": list(STEPS),
            "statistic": list(STATISTICS),
        },
    )
    for name in ("excess", "detectable"):
        data[name][1, 2, 0] = changes.get(name, data[name][1, 2, 0])
    return data


def verdicts(data):
    return {claim.id.removeprefix("plane.rjmlt-"): claim.verdict for claim in flatland_rjmlt.judge(data)}


def test_what_the_paper_says_holds_where_it_is_measured():
    said = verdicts(measured())
    assert len(said) == 12
    assert set(said.values()) == {"holds"}


@pytest.mark.parametrize(
    ("claim", "failing", "open_"),
    [
        ("small-steps", {"keep": [0.5, 0.8]}, {"keep": [0.8, 0.795]}),
        ("small-steps-change", {"change": [0.9, 0.2]}, {"change": [0.795, 0.2]}),
        ("small-steps-one-percent", {"change": [0.2, 0.1]}, {"change": [0.2, 0.02]}),
        ("jumps-accepted", {"jump": [1.0, 0.6]}, {"count": 200}),
        ("exact", {"excess": 1.1}, {"detectable": 0.12}),
    ],
)
def test_a_claim_fails_only_where_it_is_refuted(claim, failing, open_):
    assert verdicts(measured(**failing))[claim] == "fails"
    assert verdicts(measured(**open_))[claim] == "open"


def test_the_law_of_uniform_jumps_fails_where_the_weights_predict_otherwise():
    assert verdicts(measured(off=0.05))["jump-law"] == "fails"


def test_ten_edges_are_not_judged_by_fewer():
    data = measured().assign_coords(edges=[2, 5])
    assert verdicts(data)["small-steps-one-percent"] == "open"


@pytest.mark.parametrize(
    ("door", "word"),
    [
        ((0.9, 0.7, 1.2), "open"),
        ((1.3, 1.1, 1.5), "holds if the scene is box"),
    ],
)
@pytest.mark.parametrize("k", range(len(STATISTICS)))
def test_a_scene_where_one_look_does_not_agree_is_not_counted(k, door, word):
    data = measured()
    data.ratio[k, METHODS.index("RJMLT") - 1, 1, 0] = np.array(door)
    said = verdicts(data)
    assert said[STATISTICS[k]] == word
    assert all(said[other] == "holds" for other in STATISTICS if other != STATISTICS[k])


def test_one_scene_refutes_what_is_said_of_all_where_another_is_open():
    data = measured()
    data.ratio[0, METHODS.index("RJMLT") - 1, :, -1] = np.array([(0.9, 0.7, 1.2), (1.3, 1.1, 1.5)])
    assert verdicts(data)["mse"] == "fails"


def test_methods_are_compared_with_mmlt_scene_by_scene():
    """RJMLT has half the error of MMLT in the first scene, and as much in the second."""
    rng, shape = np.random.default_rng(3), (2, len(METHODS), len(STEPS), 200)
    squared = rng.gamma(4.0, size=shape)
    squared[0, METHODS.index("RJMLT")] /= 2
    found = compared(squared, squared)[:, METHODS.index("RJMLT") - 1]
    assert found.shape == (3, 2, len(LOOKS), 3)
    assert np.all(found[:, 0, :, 2] < 1)
    assert np.all((found[:, 1, :, 1] < 1) & (found[:, 1, :, 2] > 1))
    assert np.allclose(found[2], np.sqrt(found[0]))


def test_it_is_drawn_and_tabled():
    figure = flatland_rjmlt.draw(measured())
    assert len(figure.axes) == 6
    assert flatland_rjmlt.table(measured()).row_count == len(SCENES) * len(METHODS)
