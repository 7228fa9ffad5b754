"""Every mutant fails the contract, and in the equation that its entry names."""

import importlib
import pkgutil

import pytest

import mcmc1d.verify.mutants
from mcmc1d.techniques import Technique
from mcmc1d.verify import check_move, check_technique

MUTANTS = {
    name: mutant
    for module in pkgutil.iter_modules(mcmc1d.verify.mutants.__path__)
    for name, mutant in importlib.import_module(f"mcmc1d.verify.mutants.{module.name}").MUTANTS.items()
}


@pytest.mark.parametrize("name", MUTANTS)
def test_mutant_is_caught_by_the_equation_it_breaks(name):
    mutant = MUTANTS[name]
    check = check_technique if isinstance(mutant.subject, Technique) else check_move
    report = check(mutant.subject)
    caught = [failure.equation for failure in report.failures]
    assert any(mutant.caught_by in equation for equation in caught), f"{mutant.mistake}: caught by {caught}"


def test_the_wrong_ones_are_nowhere_in_the_library_proper():
    names = {type(mutant.subject).__name__ for mutant in MUTANTS.values()}
    assert not names & set(mcmc1d.moves.__all__ + mcmc1d.techniques.__all__ + mcmc1d.__all__)
