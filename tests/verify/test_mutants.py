"""Every mutant fails, in the equation or the layer that its entry names; every right twin's and trap's law is kept.

Mutants run at one seed through the settings that users get; `experiments/kill_matrix` runs 59 of them. Traps and twins
run with fewer replicas (a false alarm has probability 1e-5 whatever their number): at full size in the experiment.
"""

import pytest

import mcmc1d
from experiments import kill_matrix
from mcmc1d.techniques import Technique
from mcmc1d.verify import Verdict, check_move, check_technique, efficiency, verify
from mcmc1d.verify.mutants import LAYERS, mutants, traps

ALL = mutants()
CONTRACTS = [name for name, mutant in ALL.items() if mutant.layer == "contract"]
KERNELS = [name for name, mutant in ALL.items() if mutant.layer not in ("contract", "efficiency")]
SLOWED = [name for name, mutant in ALL.items() if mutant.layer == "efficiency"]


@pytest.mark.parametrize("name", CONTRACTS)
def test_mutant_is_caught_by_the_equation_it_breaks(name):
    mutant = ALL[name]
    check = check_technique if isinstance(mutant.subject, Technique) else check_move
    report = check(mutant.subject)
    caught = [failure.equation for failure in report.failures]
    assert any(mutant.caught_by in equation for equation in caught), f"{mutant.mistake}: caught by {caught}"


@pytest.mark.slow
@pytest.mark.parametrize("name", KERNELS)
def test_mutant_is_caught_by_the_layer_that_must(name):
    mutant = ALL[name]
    # Time for as many replicas on a loaded machine as the default buys on an idle one; none is used that is not needed.
    report = verify(mutant.subject, mutant.law, **{"seconds": 120.0, **mutant.options})
    layers = kill_matrix.convictions(report)
    assert mutant.layer in layers, f"{mutant.mistake}: caught by {layers}\n{report}"


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOWED)
def test_mutant_that_keeps_the_law_moves_differently(name):
    mutant = ALL[name]
    assert not efficiency(mutant.subject, mutant.right, mutant.law).alike
    assert efficiency(mutant.right, mutant.right, mutant.law).alike


@pytest.mark.slow
@pytest.mark.parametrize("name", traps())
def test_right_kernel_that_looks_wrong_passes(name):
    trap = traps()[name]
    report = verify(trap.subject, trap.law, replicas=2**14, **{**trap.options, "gap": None})
    assert report.verdict is Verdict.PASS, f"{trap.why}: {report}"


def test_the_catalogue_is_whole():
    assert len(ALL) >= 40
    assert all(mutant.layer in LAYERS and mutant.mistake and mutant.origin for mutant in ALL.values())
    assert all(
        mutant.law is not None and mutant.right is not None for mutant in ALL.values() if mutant.layer != "contract"
    )


def test_the_wrong_ones_are_nowhere_in_the_library_proper():
    names = {type(ALL[name].subject).__name__ for name in CONTRACTS}
    assert not names & set(mcmc1d.moves.__all__ + mcmc1d.techniques.__all__ + mcmc1d.__all__)
