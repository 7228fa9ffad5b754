"""Other libraries' kernels in the shapes that they come in: keys that `init` wants, Python's numbers in a state."""

import blackjax
import emcee
import jax.numpy as jnp
import pytest
from numpyro.infer import HMC

from mcmc1d.verify import efficiency, laws, verify

LAW = laws.normal(2)


def _generalised(scale):
    return blackjax.ghmc(LAW.log_density, 0.3, scale * jnp.ones(2), 0.3, 0.05)


def test_an_init_with_a_key_that_only_seems_optional():
    assert verify(_generalised(1.0), LAW, replicas=2**14).passed


def test_a_momentum_from_another_law_is_told():
    """BlackJAX's own init draws unit momenta, whatever their scale: the kernel is right, and does not start right."""
    report = verify(_generalised(0.25), LAW, replicas=2**17)
    assert not report.passed
    assert any("init draws" in line for line in report.diagnosis)


@pytest.mark.parametrize("length", [{"num_steps": 4}, pytest.param({"trajectory_length": 1.2}, marks=pytest.mark.slow)])
def test_a_number_of_python_in_a_state(length):
    kernel = HMC(
        potential_fn=lambda x: 0.5 * jnp.sum(x * x),
        step_size=0.3,
        adapt_step_size=False,
        adapt_mass_matrix=False,
        **length,
    )
    assert verify(kernel, LAW, replicas=2**14).passed


def test_walkers_of_an_ensemble_are_no_independent_pairs():
    """They can not be declared reversible; of each ensemble one is compared, so that a move is as fast as itself."""
    move = emcee.moves.StretchMove()
    with pytest.raises(ValueError, match="the walkers of an ensemble move by each other"):
        verify(move, LAW, reversible=True)
    assert efficiency(move, move, LAW, replicas=2**12, steps=(1, 4)).alike
    slow = efficiency(emcee.moves.StretchMove(a=1.02), move, LAW, replicas=2**12, steps=(1, 4))
    assert not slow.alike
