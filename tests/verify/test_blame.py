"""Who is to blame at a stage, the kernel or its law: with p-values that are given, not drawn."""

from types import SimpleNamespace

import pytest

from mcmc1d.verify import LawError, Scheme
from mcmc1d.verify.sampler import Tally
from mcmc1d.verify.trial import Trial

OWN, KERNEL = (0, 0), (64, 0)


@pytest.fixture
def decided(monkeypatch):
    """Whether it failed, and its stages, of one pair of p-values each: of the law's own draws, of the kernel."""

    def of(*stages, more=1.0):
        trial = object.__new__(Trial)  # of a sampler it needs no more than the steps
        trial.sampler, trial.scheme, trial.keys = SimpleNamespace(steps=(64,)), Scheme(1e-5), [OWN, KERNEL]
        trial.n, trial.grow, trial.replicas, trial.reasons, trial.inconclusive = 1000, 4, 0, [], []
        values = iter(stages)

        def gather(stage, n):
            trial.given = dict(zip(trial.keys, next(values), strict=True))
            tally = Tally(n)
            tally.moved = n
            return tally

        def blame():
            if min(trial.given[OWN], more) <= trial.scheme.beta(1) / 2:
                raise LawError("the law")

        monkeypatch.setattr(trial, "_gather", gather)
        monkeypatch.setattr(trial, "p_values", lambda tally: trial.given)
        monkeypatch.setattr(trial, "_clear_the_law", lambda tally: blame())
        monkeypatch.setattr(trial, "_failed", lambda tally: trial.reasons.append("the kernel"))
        monkeypatch.setattr(trial, "_stray", lambda tally: None)
        trial.decide(ergodic=False)
        return bool(trial.reasons), trial.stages

    return of


def test_a_kernel_that_is_right_passes_and_a_wrong_one_fails(decided):
    assert decided((0.5, 0.5)) == (False, 1)
    assert decided((0.5, 1e-9)) == (True, 1)
    assert decided((0.5, 1e-3), (0.5, 1e-5)) == (True, 2)


def test_the_laws_own_draws_alone_fail_no_kernel(decided):
    """At a late stage: whether the kernel passes or goes on is asked of its own p-values."""
    assert decided((0.5, 1e-3), (0.5, 1e-3), (1e-4, 0.5)) == (False, 3)
    assert decided((0.5, 1e-3), (0.5, 1e-3), (1e-4, 2e-3), (0.5, 1e-3)) == (True, 4)


def test_a_law_is_blamed_by_the_evidence_of_a_first_stage(decided):
    with pytest.raises(LawError):
        decided((0.5, 1e-3), (0.5, 1e-3), (1e-9, 1e-3))
    with pytest.raises(LawError):
        decided((0.5, 1e-9), more=1e-9)
