"""One verification on its way: how many replicas, all stages, whether it moves and forgets."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import jax
import numpy as np
from scipy.stats import binom

from mcmc1d.checks import require
from mcmc1d.verify.battery import OneSample, TwoSample, coordinates
from mcmc1d.verify.contradictions import (
    require_alike,
    require_cells,
    require_density,
    require_fit,
    require_one_density,
    require_random,
)
from mcmc1d.verify.design import design, main_coordinates, partitions
from mcmc1d.verify.energy import Energy
from mcmc1d.verify.forgetting import REPLICAS, Forgetting, forgets
from mcmc1d.verify.ledger import Scheme
from mcmc1d.verify.power import LEAST, Power
from mcmc1d.verify.sampler import Sampler, Tally, slack
from mcmc1d.verify.statistic import Position

AIM = 0.005
"""The CDF gap that is aimed at unless one is asked for."""
_LOOKS = 16  # the early look is at this fraction of the first stage
_RATE = 0.01  # a kernel that moves more often than that does not fail for never having moved
_MORE = 2**22  # of the law's own draws, from which on four times the replicas do for eight
_NARROW = 1e-20  # a p-value over which a failure may come from a law that is slightly wrong: more of its draws tell
_STARTS = 7  # the least likely draw, and both ends of up to three coordinates


@dataclass
class Trial:
    """One verification on its way."""

    sampler: Sampler
    scheme: Scheme
    sure: float
    """The probability with which a gap is to be detected."""
    progress: Callable[[int, int], None] | None
    n: int = 0
    grow: int = 4
    """How many times the first stage's replicas the second has."""
    reasons: list[str] = field(default_factory=list)
    inconclusive: list[str] = field(default_factory=list)
    first: Tally = field(default_factory=Tally)
    deciding: Tally = field(default_factory=Tally)
    p_value: float = 1.0
    stages: int = 0
    replicas: int = 0
    forgotten: Forgetting = field(default_factory=Forgetting)

    def prepare(self) -> None:
        """Look at the law and the kernel with a few draws, and choose the tests."""
        sampler, subject = self.sampler, self.sampler.subject
        draws = sampler.draw("design", 0, 0, 2 * REPLICAS)
        require_fit(sampler.law, draws)
        sampler.slack = slack(draws)
        sampler.require_inside(draws)
        require_random(sampler.law, draws, sampler.draw("pilot", 0, 0, 2 * REPLICAS))
        few = jax.tree.map(lambda a: a[: subject.unit], draws)
        subject.check(few)
        if subject.most is not None:
            sampler.max_weight = subject.most
        sampler.energy = None if sampler.law.log_density is None else Energy(sampler.law)
        look = next(iter(subject.watch(sampler.words("pilot"), 0, few, (1,))))
        self.tests = sampler.tests = design(
            sampler.law,
            draws,
            reversible=bool(subject.reversible),
            deposits=look if look.picked is not None else None,
            max_weight=sampler.max_weight / subject.total,
            deposited=subject.deposited,
            energy=sampler.energy,
        )
        if look.picked is not None and not any(test.layer == "deposits" for test in self.tests):
            self.inconclusive.append(
                "its deposits are of another law, of which no exact value is known: they were not looked at; verify "
                "Metropolis of the same move for the chain alone"
            )
        own = [(0, k) for k, test in enumerate(self.tests) if sampler.own(test)]
        self.keys = own + [(t, k) for t in sampler.steps for k in range(len(self.tests))]
        self.power = Power(self.scheme, self.tests, len(self.keys), self.sure)
        self.unlikely = self._unlikely(draws)

    def size(self, gap: float | None, seconds: float, replicas: int | None) -> None:
        """Choose how many replicas: what the gap takes, or what the time affords; and the unit, from their number."""
        known, goal = gap is None, AIM if gap is None else gap
        needed, at_once = (self.power.replicas(goal, grow, known=known) for grow in (self.grow, 1))
        if replicas is not None:
            require(replicas >= LEAST, f"{replicas} replicas are too few; give {LEAST} or more")
            n = replicas
        else:
            affordable = int(seconds * self.sampler.workers / self.sampler.seconds_a_replica())
            n = needed
            if at_once <= affordable < self.grow * needed:
                # The second stage would take too long: rather find the gap at the first, where that can be afforded.
                n = at_once
            elif affordable < needed:
                # A quarter of a power of two, so that two runs of one kernel on one machine mostly agree on it.
                octave = 1 << max(affordable.bit_length() - 3, 0)
                n = max(LEAST, affordable // octave * octave)
        per_look, subject = -(-n // _LOOKS), self.sampler.subject
        if per_look < subject.unit:
            subject.unit = max(subject.least_unit, 1 << (per_look - 1).bit_length())
        self.n = n if replicas is not None else _LOOKS * (-(-per_look // subject.unit) * subject.unit)
        # By their number alone, so that a report's replicas make the same run again: fewer than the gap needs, or as
        # many as find it at once, get further stages of the same size.
        self.grow = self.grow if needed <= self.n < at_once else 1

    def _unlikely(self, draws: Position) -> Position:
        """The draws, the least likely first."""
        if self.sampler.energy is not None:
            values = self.sampler.energy(draws)
            require_density(self.sampler.law, draws, values)
            require_one_density(self.sampler.law, draws, self.sampler.energy)
            order = np.argsort(values)
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
                self._clear_the_law(tally)
                verdict = self.scheme.decide(stage, self.combined(tally, own=False))
            if verdict == "fail":
                self._failed(tally)
                return
            if verdict == "pass":
                self._stray(tally)
                break
            n = n * self.grow if stage == 1 else n
        still = f"it never moves: no replica was elsewhere after any of {self.sampler.steps} steps"
        if self.deciding.moved and ergodic and self.deciding.still:
            still = f"it never moves {', '.join(sorted(self.deciding.still))}; ergodic=False is for a part of a kernel"
        elif self.deciding.moved:
            if ergodic:
                self.forget()
            return
        # Few replicas of a kernel that seldom moves may all stay, in any coordinate; so do many of one that next to
        # never does.
        chance = self.scheme.level * self.scheme.motion / 2 / len(coordinates(self.unlikely))
        few = self.deciding.n * np.log1p(-_RATE) > np.log(chance)
        (self.inconclusive if few else self.reasons).append(still)

    def _leaves(self, tally: Tally) -> None:
        """Fail for too many replicas where the law has no probability: outside of its support, or of density zero.

        Should the law have a thin tail there all the same (all of its own draws are inside, or it raises; and few may
        be where the density rounds to zero), a right kernel's replicas come there as often as they leave it: k against
        none with a probability of 2^-k, whenever one looks. Half of `Scheme.motion` is spent on it, over all numbers of
        steps and stages.
        """
        most, fewest = max(tally.outside.values(), key=lambda counts: counts[0] - counts[1], default=(0, 0))
        chance = self.scheme.level * self.scheme.motion / 2 / (len(self.sampler.steps) * self.scheme.stages)
        if binom.logsf(most - 1, most + fewest, 0.5) <= np.log(chance):
            self.reasons.append(
                f"{most} of {tally.n} replicas leave the support, {tally.example}; reject such proposals"
            )

    def _stray(self, tally: Tally) -> None:
        """Of a few replicas outside of the support, or in no cell of a law, nothing can be concluded."""
        come, left = np.max(list(tally.outside.values()), axis=0, initial=0) if tally.outside else (0, 0)
        # Where draws of the law are, too, there is nothing to wonder at.
        places = {"outside of the support": 0 if left else int(come)}
        for (t, k), counts in tally.counts.items():
            if t > 0 and isinstance(self.tests[k], OneSample):
                places[f"in no cell of {self.tests[k].name}"] = int(counts[0][-1])
        for where, count in places.items():
            if count:
                example = f", {tally.example}" if tally.example else ""
                self.inconclusive.append(
                    f"{count} of {tally.n} replicas were {where}{example}: too few to tell a mistake from a tail that "
                    f"{self.sampler.law.name} leaves out; give the tail to its end cells, or reject such proposals"
                )
                return

    def _gather(self, stage: int, n: int) -> Tally:
        total, looked = Tally(), False
        for tally in self.sampler.stage(stage, n, _LOOKS):
            if tally.wrong:
                self.reasons += tally.wrong
                total.n += tally.n
                return total
            total.add(tally)
            require_cells(self.sampler.law, self.tests, total)
            self._leaves(total)
            if self.reasons:
                return total
            if self.progress is not None:
                self.progress(total.n, n)
            if stage == 1 and not looked and total.n * _LOOKS >= n:
                looked = True
                if self.combined(total) <= self.scheme.early:
                    self._clear_the_law(total)
                    self._failed(total)
                    return total
        return total

    def p_values(self, tally: Tally) -> dict[tuple[int, int], float]:
        """Each test's own."""
        return {key: self.tests[key[1]].p_value(tally.counts[key]) for key in self.keys if key in tally.counts}

    def combined(self, tally: Tally, own: bool = True) -> float:
        """The smallest p-value times the number of tests; `own`: or of those of the kernel, without the law's draws."""
        values = [p for (steps, _), p in self.p_values(tally).items() if own or steps > 0]
        return min(1.0, len(self.keys) * min(values, default=1.0))

    def _clear_the_law(self, tally: Tally) -> None:
        """Raise `LawError` where the law has failed, and not the kernel: by as much evidence as a first stage needs.

        A late stage asks for little, because a right kernel seldom comes there. A wrong one does, and its law may be
        right; four times as many of the law's own draws, or eight, tell.
        """
        self._blame_the_law(tally)
        if min(self.p_values(tally).values()) > _NARROW and any(steps == 0 for steps, _ in self.keys):
            more = max(4 * tally.n, min(8 * tally.n, _MORE))
            self._blame_the_law(self.sampler.of_the_law(self.stages, more))

    def _failed(self, tally: Tally) -> None:
        values = {key: p for key, p in self.p_values(tally).items() if key[0] > 0}
        worst = min(values, key=lambda key: values[key])
        test, after = self.tests[worst[1]], f"after {worst[0]} step{'s' * (worst[0] > 1)}"
        self.reasons.append(
            {
                "marginal": f"the law of {test.name} is wrong {after}",
                "joint": f"the joint law of {test.name} is wrong {after}",
                "density": f"the law of the {test.name} is wrong {after}",
                "deposits": f"the deposits' law of {test.name} is wrong {after}",
                "exchangeability": f"it is declared reversible and is not: {test.name} {after}",
            }[test.layer]
        )

    def _blame_the_law(self, tally: Tally) -> None:
        """Raise `LawError` where the law's own draws do not have what is known of it."""
        threshold = self.scheme.beta(1) / len(self.keys)
        require_alike(self.sampler.law, self.tests, tally, self.p_values(tally), threshold, self.unlikely)

    def forget(self) -> None:
        """Whether chains from some bad points come near the law, and after how many steps."""
        sampler, subject = self.sampler, self.sampler.subject
        points = self._bad_points()
        total = min(REPLICAS, max(subject.unit, self.n))
        count = min(len(jax.tree.leaves(points)[0]), max(1, total // 512))
        # Whole groups of what moves together: one that was filled up would have the same start twice.
        n = max(1, total // count // subject.together) * subject.together
        points = jax.tree.map(lambda a: a[:count], points)
        own = [test for test in self.tests if isinstance(test, OneSample | TwoSample) and not test.deposits]
        tests = [*own, *partitions(sampler.law, self.unlikely)]
        starts = subject.crowd(points, self.unlikely, n)
        fresh = sampler.draw("forget", 0, 0, n)
        # Where draws of the law are, too, there is nothing to wonder at.
        rounds = any(left for _, left in self.deciding.outside.values())
        outside = partial(sampler.outside, dark=not rounds)
        self.forgotten = forgets(subject, tests, starts, fresh, sampler.words("walk"), sampler.inspect, outside)
        self.reasons += self.forgotten.reasons
        self.inconclusive += self.forgotten.doubts

    def _bad_points(self) -> Position:
        """The user's bad start, the least likely draw, and the draws near both ends of a few coordinates.

        At 1 % and 99 %: at the very ends a right kernel may hardly move (MALA at a wall).
        """
        rows = [0]
        columns = coordinates(self.unlikely)
        for name in main_coordinates(self.sampler.law, self.unlikely):
            if len(rows) < _STARTS:
                order = np.argsort(columns[name], kind="stable")
                rows += [int(order[len(order) // 100]), int(order[-len(order) // 100])]
        rows = list(dict.fromkeys(rows))
        points = jax.tree.map(lambda a: np.asarray(a)[rows], self.unlikely)
        bad = self.sampler.law.bad_start
        if bad is None:
            return points
        return jax.tree.map(lambda a, b: np.concatenate([np.asarray(b, a.dtype)[None], a]), points, bad)
