"""Figure 3 from end to end, small: right integrators accepted, a wrong one rejected, its law predicted, all drawn."""

import numpy as np
import pytest

from experiments import rjmlt_fig3
from experiments.support.sweep import Sweep

pytestmark = pytest.mark.slow

SMALL = rjmlt_fig3.Config(
    bins=20,
    replicas=2**14,
    replica_steps=32,
    chains=2**11,
    steps=128,
    burn=256,
    blocks=8,
    operator_points=2**17,
)


@pytest.fixture(scope="module")
def data():
    stages = set()
    found = rjmlt_fig3.run(SMALL, 0, Sweep(lambda stage, done, total: stages.add(stage)))
    assert stages  # it shows how far it is
    return found


def test_right_integrators_are_accepted_and_the_wrong_one_is_not(data):
    """A right one is rejected with a probability of 2e-6; without its Jacobian the law is off by a TV of 0.2."""
    smallest = dict(zip(data.integrator.values, np.minimum(data.p_x, data.p_joint).values, strict=True))
    assert all(smallest[name] >= SMALL.level for name, right in rjmlt_fig3.RIGHT.items() if right)
    assert smallest["no Jacobian"] < SMALL.level


def test_the_operator_predicts_what_is_simulated(data):
    """Up to the simulation's noise, which is stated; the exact law is farther away than that."""
    for name in ("no Jacobian", "fixed point"):
        here = data.sel(integrator=name)
        assert float(here.prediction_distance) < float(here.prediction_noise) + 0.01
        assert float(here.total_variation) > float(here.prediction_distance)
    assert np.isnan(data.sel(integrator="full").predicted).all()


def test_chains_take_longer_to_forget_than_independent_draws(data):
    """A mean over 128 steps can vary by no more than one draw, and of these integrators by some tens of steps."""
    assert np.all((data.autocorrelation_time > 5) & (data.autocorrelation_time < SMALL.steps))


def test_every_claim_is_judged_and_the_figure_drawn(data):
    claims = {claim.id: claim for claim in rjmlt_fig3.judge(data)}
    assert len(claims) == 8
    for name in ("multiplexed", "full", "full-aimed", "no-jacobian", "aimed-accepts"):
        assert claims[f"rjmlt.{name}"].as_expected, claims[f"rjmlt.{name}"]
    assert len(rjmlt_fig3.draw(data).axes) == 15
    assert rjmlt_fig3.table(data).row_count == 5
