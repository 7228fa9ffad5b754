"""What a verification has found: its verdict, the reasons, and all that they rest on."""

from mcmc1d.verify.battery import OneSample
from mcmc1d.verify.control import doubts
from mcmc1d.verify.design import unseen
from mcmc1d.verify.diagnose import diagnose
from mcmc1d.verify.library import LibrarySubject
from mcmc1d.verify.report import Report, Result, Verdict
from mcmc1d.verify.trial import Trial

SETTLE = 0.05
"""The gap up to which a slow kernel may still PASS, where none was asked for."""


def concluded(trial: Trial, name: str, seed: int, gap: float | None, seconds: float) -> Report:
    """The report of a trial whose stages are done; `gap`: what was asked for, `seconds`: what it took."""
    bought, limit = trial.power.gap(trial.n, trial.grow), SETTLE if gap is None else gap
    unsure = list(trial.inconclusive)
    if not trial.reasons and limit * (1 + 1e-9) < bought:
        unsure.append(
            f"a gap of {limit:g} with probability {trial.sure:g} is out of reach: {trial.n} replicas detect "
            f"{bought:.2g}; allow more seconds= or replicas=, or a larger gap="
        )
    verdict = Verdict.FAIL if trial.reasons else Verdict.INCONCLUSIVE if unsure else Verdict.PASS
    threshold = trial.scheme.beta(max(trial.stages, 1)) / len(trial.keys)
    return Report(
        untested=_untested(trial),
        name=name,
        kernel=trial.sampler.subject.name,
        law=trial.sampler.law.name,
        verdict=verdict,
        reasons=trial.reasons or unsure,
        level=trial.scheme.level,
        threshold=threshold,
        p_value=trial.p_value,
        stages=trial.stages,
        replicas=trial.replicas,
        first_replicas=trial.n,
        gap=bought,
        gap_in=trial.power.gap_in,
        power=trial.sure,
        moved=trial.deciding.moved / max(trial.deciding.n, 1),
        forgotten=trial.forgotten.steps,
        forgotten_within=trial.forgotten.within,
        resolution=max((test.resolution for test in trial.power.headline), default=0.0),
        reversible=bool(trial.sampler.subject.reversible),
        first_stage={
            f"{test.layer}: {test.name} after {t}": test.p_value(trial.first.counts[t, k])
            for (t, k) in trial.keys
            for test in [trial.tests[k]]
            if (t, k) in trial.first.counts
        },
        deciding_replicas=trial.deciding.n,
        seed=seed,
        seconds=seconds,
        steps=trial.sampler.steps,
        tests=len(trial.keys),
        results=_results(trial, threshold),
        diagnosis=_diagnosis(trial) if verdict is Verdict.FAIL else [],
    )


def _results(trial: Trial, threshold: float) -> list[Result]:
    """Each test's, of the deciding stage."""
    results = []
    for (t, k), p in trial.p_values(trial.deciding).items():
        test, counts = trial.tests[k], trial.deciding.counts[t, k]
        curve = test.curve(counts)
        results.append(
            Result(
                layer="law" if t == 0 else test.layer,
                name=test.name,
                steps=t,
                p_value=p,
                gap=trial.power.detectable(test, trial.n, trial.grow),
                where=test.worst(counts, 5) if p <= threshold else [],
                curve=None if curve is None else [float(c) for c in curve],
                residuals=[float(r) for r in test.residuals(counts)] if isinstance(test, OneSample) else None,
            )
        )
    return results


def _diagnosis(trial: Trial) -> list[str]:
    """What a failure may come from."""
    sampler, subject, found = trial.sampler, trial.sampler.subject, []
    if isinstance(subject, LibrarySubject) and trial.deciding.counts:
        found += diagnose(subject, sampler.words("one step"), sampler.draw("diagnosis", 0, 0, 2**17))
    if subject.drawn(trial.unlikely):
        found.append(
            "init draws a part of the state: from another law than its own (a momentum of another scale), a right "
            "kernel fails too"
        )
    if subject.alike(trial.unlikely):
        found.append(
            "chains at one place all move alike: where they share a random number, no p-value holds; draw one for "
            "each, of size=len(x)"
        )
    return found + doubts(sampler)


def _untested(trial: Trial) -> list[str]:
    """What a PASS says nothing of."""
    sampler, found = trial.sampler, []
    if not sampler.subject.reversible:
        found.append("detailed balance: reversible=True declares it, and sees far smaller mistakes that break it")
    reached, looked = trial.forgotten.steps or 0, max(sampler.steps)
    if reached > looked:
        found.append(
            f"the law that it has after more than {looked} steps: it takes some {reached} to reach its own, which "
            f"may be further off than this gap; steps=(1, {reached}) looks there"
        )
    return found + unseen(sampler.law, trial.unlikely, trial.tests)
