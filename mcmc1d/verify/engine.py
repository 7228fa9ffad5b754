"""`verify`: a verdict with an error rate, for any kernel whose stationary law is known exactly."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from mcmc1d.numerics import require
from mcmc1d.verify.adapters import as_subject
from mcmc1d.verify.battery import OneSample, Test, TwoSample, coordinates
from mcmc1d.verify.design import design
from mcmc1d.verify.diagnose import diagnose
from mcmc1d.verify.forgetting import REPLICAS, forgets
from mcmc1d.verify.law import Position, as_law
from mcmc1d.verify.ledger import Ledger, Scheme
from mcmc1d.verify.library import LibrarySubject
from mcmc1d.verify.report import Report, Result, Verdict
from mcmc1d.verify.sampler import Sampler, Tally, entropy

AIM = 0.005
"""The CDF gap that is aimed at unless one is asked for."""
SETTLE = 0.05
"""The gap up to which a slow kernel may still PASS, where none was asked for."""
_LOOKS = 16  # the early look is at this fraction of the first stage


class LawError(ValueError):
    """The law contradicts itself: its sampler and its exact values disagree."""


def verify(
    kernel: Any,
    target: Any,
    *,
    seed: int = 0,
    level: float | None = None,
    gap: float | None = None,
    power: float = 0.99,
    seconds: float = 40.0,
    replicas: int | None = None,
    steps: Sequence[int] = (1, 4, 16, 64),
    reversible: bool | None = None,
    ergodic: bool = True,
    deposits: Callable | None = None,
    max_weight: float = 1.0,
    name: str = "",
    ledger: Ledger | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Report:
    """Whether a kernel leaves a law invariant, moves, and gets there; with the error rate of saying so.

    Independent replicas start exactly from the law and are tested after each of `steps` steps: no burn-in, no
    autocorrelation, p-values that hold far in the tail. Sequential after Gandy and Scott (see `Scheme`); never
    repeated on failure. The same seed and `replicas` give the same report.

    Args:
        kernel: a move or kernel of this library (`target` a `Multiplexed`); a JAX function `step(key, position)` that
            returns the position, or (position, info); a `JaxKernel`, a `HostKernel`; a BlackJAX algorithm, a NumPyro
            kernel, an emcee move.
        target: a `Law`, a `Multiplexed`, a frozen scipy distribution, or an object with `sample` and `cdf`.
        seed: of all random numbers, with `name`.
        level: the probability that a right kernel fails; 1e-5, or the ledger's share.
        gap: the CDF gap to detect, or be INCONCLUSIVE. Without it 0.005 is aimed at, and whatever up to 0.05 the time
            affords is reported.
        power: the probability with which the gap is detected.
        seconds: what a first stage may take (a kernel that needs less takes less).
        replicas: how many in the first stage, in place of `gap` and `seconds`.
        steps: after how many steps the law is tested.
        reversible: declare detailed balance, so that (first, last) must be exchangeable. Declared for moves of this
            library, and for nothing else.
        ergodic: False for a kernel that is only invariant, such as one half of a Gibbs sweep: then it need not move
            every coordinate nor forget a bad start.
        deposits: `(state, info) -> (points, weights)` of a JAX kernel: what an estimator adds up after each step. Its
            expectation must be the law's.
        max_weight: a bound on the deposits' total weight in a step.
        name: of the test; the random numbers derive from it and from the seed.
        ledger: deals out the level.
        progress: called with the replicas done and the replicas of the stage.

    Raises `ValueError` for a kernel or a law that can not be run, `LawError` for a law whose sampler and exact values
    disagree.

    """
    began = time.perf_counter()
    law = as_law(target)
    subject = as_subject(kernel, target, law, reversible=reversible, deposits=deposits, max_weight=max_weight)
    require(
        len(steps) > 0 and list(steps) == sorted(set(steps)) and steps[0] >= 1, f"steps must rise from 1 on: {steps}"
    )
    require(gap is None or 0 < gap < 1, f"gap is a difference of two CDFs, between 0 and 1, not {gap}")
    require(seconds > 0, f"seconds is a time and positive, not {seconds}")
    for what, value in (("seed", seed), ("replicas", replicas), *(("steps", k) for k in steps)):
        require(value is None or isinstance(value, int | np.integer), f"{what} must be a whole number, not {value!r}")
    require(0.5 <= power < 1, f"power is a probability from 0.5 to 1, not {power}")
    require(max_weight >= 1, f"max_weight is the largest total weight of a step, 1 or more, not {max_weight}")
    name = name or f"{subject.name} on {law.name}"
    if level is None:
        level = 1e-5 if ledger is None else ledger.share(name)
    sampler = Sampler(law, subject, entropy(seed, name), tuple(steps), max_weight)
    run = Run(sampler, Scheme(level), power, progress)
    run.prepare()
    run.size(gap, seconds, replicas)
    run.decide(ergodic)
    return run.report(name, seed, gap, replicas, time.perf_counter() - began)


@dataclass
class Run:
    """One verification on its way."""

    sampler: Sampler
    scheme: Scheme
    power: float
    progress: Callable[[int, int], None] | None
    n: int = 0
    grow: int = 4
    reasons: list[str] = field(default_factory=list)
    inconclusive: list[str] = field(default_factory=list)
    first: Tally = field(default_factory=Tally)
    deciding: Tally = field(default_factory=Tally)
    p_value: float = 1.0
    stages: int = 0
    replicas: int = 0
    forgotten: int | None = None

    def prepare(self) -> None:
        """Look at the law and the kernel with a few draws, and choose the tests."""
        sampler, subject = self.sampler, self.sampler.subject
        draws = sampler.draw("design", 0, 0, 2 * REPLICAS)
        few = jax.tree.map(lambda a: a[: subject.unit], draws)
        subject.check(few)
        look = next(iter(subject.watch(sampler.words("pilot"), 0, few, (1,))))
        self.tests = sampler.tests = design(
            sampler.law,
            draws,
            reversible=bool(subject.reversible),
            deposits=look if look.picked is not None else None,
            max_weight=sampler.max_weight,
        )
        own = [(0, k) for k, test in enumerate(self.tests) if sampler.own(test)]
        self.keys = own + [(t, k) for t in sampler.steps for k in range(len(self.tests))]
        self.unlikely = self._unlikely(draws)

    @property
    def threshold(self) -> float:
        """The p-value at which one test fails at the first stage."""
        return self.scheme.first / len(self.keys)

    def gap(self, n: int) -> float:
        """The smallest gap that n replicas detect in any coordinate whose CDF is known, or else in any at all.

        Infinite where no coordinate is ordered.
        """
        headline = [test for test in self.tests if _headline(test)]
        exact = [test for test in headline if isinstance(test, OneSample)]
        gaps = [test.gap(n, self.threshold, 1 - self.power) for test in exact or headline]
        return max((g for g in gaps if g is not None), default=np.inf)

    def size(self, gap: float | None, seconds: float, replicas: int | None) -> None:
        """Choose how many replicas: what the gap takes, or what the time affords."""
        aim = AIM if gap is None else gap
        if replicas is not None:
            require(replicas >= _LOOKS, f"{replicas} replicas are too few; give {_LOOKS} or more")
            self.n = replicas
            return
        needed = _LOOKS
        while self.gap(needed) > aim and needed < 2**27:
            needed = int(needed * 1.02) + 1
        affordable = int(seconds * self.sampler.workers / self.sampler.seconds_a_replica())
        if affordable < needed:
            # A quarter of a power of two, so that two runs of one kernel on one machine mostly agree on it.
            octave = 1 << max(affordable.bit_length() - 3, 0)
            needed = max(_LOOKS, affordable // octave * octave)
        if affordable < 4 * needed:
            self.grow = 1  # what is slow gets further stages of the same size
        per_look = -(-needed // _LOOKS)
        subject = self.sampler.subject
        if per_look < subject.unit:
            subject.unit = max(subject.least_unit, 1 << (per_look - 1).bit_length())
        self.n = _LOOKS * (-(-per_look // subject.unit) * subject.unit)

    def _unlikely(self, draws: Position) -> Position:
        """The draws, the least likely first."""
        log_density = self.sampler.law.log_density
        if log_density is not None:
            order = np.argsort(np.asarray(jax.vmap(log_density)(draws)))
        else:
            first = next(iter(coordinates(draws).values()))
            order = np.argsort(-np.abs(first - np.median(first)))
        return jax.tree.map(lambda a: np.asarray(a)[order], draws)

    def decide(self, ergodic: bool) -> None:
        """All stages; then whether it moves, and whether it forgets."""
        n = self.n
        for stage in range(1, self.scheme.stages + 1):
            tally = self._gather(stage, n)
            self.stages, self.deciding, self.replicas = stage, tally, self.replicas + tally.n
            if stage == 1:
                self.first, self.p_value = tally, self.combined(tally)
            if self.reasons:
                return
            verdict = self.scheme.decide(stage, self.combined(tally))
            if verdict == "fail":
                self._failed(tally)
                return
            if verdict == "pass":
                break
            n = n * self.grow if stage == 1 else n
        if self.deciding.moved == 0:
            self.reasons.append(f"it never moves: no replica was elsewhere after any of {self.sampler.steps} steps")
        elif ergodic and self.deciding.still:
            self.reasons.append(
                f"it never moves {', '.join(sorted(self.deciding.still))}; if it is only a part of a kernel, say "
                "ergodic=False"
            )
        elif ergodic:
            self.forget()

    def _gather(self, stage: int, n: int) -> Tally:
        total, looked = Tally(), False
        for tally in self.sampler.stage(stage, n, _LOOKS):
            if tally.wrong:
                self.reasons += tally.wrong
                total.n += tally.n
                return total
            total.add(tally)
            if self.progress is not None:
                self.progress(total.n, n)
            if stage == 1 and not looked and total.n * _LOOKS >= n:
                looked = True
                if self.combined(total) <= self.scheme.early:
                    self._failed(total)
                    return total
        return total

    def p_values(self, tally: Tally) -> dict[tuple[int, int], float]:
        """Each test's own."""
        return {key: self.tests[key[1]].p_value(tally.counts[key]) for key in self.keys if key in tally.counts}

    def combined(self, tally: Tally) -> float:
        """The smallest p-value times the number of tests."""
        return min(1.0, len(self.keys) * min(self.p_values(tally).values(), default=1.0))

    def _failed(self, tally: Tally) -> None:
        values = self.p_values(tally)
        worst = min(values, key=lambda key: values[key])
        test = self.tests[worst[1]]
        if min((p for (t, _), p in values.items() if t == 0), default=1.0) <= self.threshold:
            where = "; ".join(test.worst(tally.counts[worst], 3))
            raise LawError(
                f"{self.sampler.law.name}: its sampler and its exact law of {test.name} disagree "
                f"(p = {values[worst]:.1e} from {tally.n} draws): {where}. Mend the sampler, the cdf, bins or masses"
            )
        self.reasons.append(
            f"its {test.layer} law is wrong: {test.name} after {worst[0]} step{'s' * (worst[0] > 1)}"
            if test.layer != "exchangeability"
            else f"it is declared reversible and is not: {test.name} after {worst[0]} step{'s' * (worst[0] > 1)}"
        )

    def forget(self) -> None:
        """Whether chains from one bad point come near the law, and after how many steps."""
        sampler, subject, law = self.sampler, self.sampler.subject, self.sampler.law
        n = min(REPLICAS, max(subject.unit, self.n))
        bad = jax.tree.map(lambda a: a[0], self.unlikely)
        if law.bad_start is not None:
            bad = jax.tree.map(lambda a, like: np.asarray(a, like.dtype), law.bad_start, bad)
        start = subject.crowd(bad, self.unlikely, n)
        tests = [test for test in self.tests if isinstance(test, OneSample | TwoSample) and not test.deposits]
        fresh = sampler.draw("forget", 0, 0, n)
        found = forgets(subject, tests, start, fresh, sampler.words("walk"), sampler.inspect)
        self.forgotten = found.steps
        self.reasons += found.reasons
        self.inconclusive += found.doubts

    def report(self, name: str, seed: int, gap: float | None, replicas: int | None, seconds: float) -> Report:
        """The verdict and all that it rests on."""
        bought = self.gap(self.n)
        if not self.reasons and replicas is None:
            limit = SETTLE if gap is None else gap
            if np.isfinite(bought) and bought > limit * (1 + 1e-9):
                self.inconclusive.append(
                    f"a gap of {limit:g} with probability {self.power:g} is out of reach: the time affords {self.n} "
                    f"replicas, which detect {bought:.2g}; allow more seconds= or a larger gap="
                )
        verdict = Verdict.FAIL if self.reasons else Verdict.INCONCLUSIVE if self.inconclusive else Verdict.PASS
        values = self.p_values(self.deciding)
        threshold = self.scheme.beta(max(self.stages, 1)) / len(self.keys)
        results = []
        for (t, k), p in values.items():
            test, counts = self.tests[k], self.deciding.counts[t, k]
            curve = test.curve(counts)
            results.append(
                Result(
                    layer="law" if t == 0 else test.layer,
                    name=test.name,
                    steps=t,
                    p_value=p,
                    gap=test.gap(self.n, self.threshold, 1 - self.power),
                    where=test.worst(counts, 5) if p <= threshold else [],
                    curve=None if curve is None else [float(c) for c in curve],
                    residuals=[float(r) for r in test.residuals(counts)] if isinstance(test, OneSample) else None,
                )
            )
        diagnosis: list[str] = []
        sampler, subject = self.sampler, self.sampler.subject
        if verdict is Verdict.FAIL and isinstance(subject, LibrarySubject) and self.deciding.counts:
            diagnosis = diagnose(subject, sampler.words("diagnosis"), sampler.draw("diagnosis", 0, 0, 2**17))
        return Report(
            name=name,
            kernel=subject.name,
            law=sampler.law.name,
            verdict=verdict,
            reasons=self.reasons or self.inconclusive,
            level=self.scheme.level,
            threshold=threshold,
            p_value=self.p_value,
            stages=self.stages,
            replicas=self.replicas,
            first_replicas=self.n,
            gap=bought,
            power=self.power,
            moved=self.deciding.moved / max(self.deciding.n, 1),
            forgotten=self.forgotten,
            seed=seed,
            seconds=seconds,
            steps=sampler.steps,
            tests=len(self.keys),
            results=results,
            diagnosis=diagnosis,
        )


def _headline(test: Test) -> bool:
    """Whether it is a coordinate's own law, and not that of a chain's primary sample."""
    return test.layer == "marginal" and test.name != "u" and not test.name.startswith("u[")
