"""The levels: one family-wise false-alarm rate for a whole run, and the sequential scheme that spends a share of it."""

from dataclasses import dataclass, field
from typing import Literal

from mcmc1d.checks import require, require_whole


@dataclass(frozen=True)
class Scheme:
    """Gandy and Scott's sequential test (2020, "Unit testing for MCMC and other Monte Carlo methods"), with a look.

    At stage j, with p the combined p-value of m tests: p <= beta_j fails; p > gamma + beta_j passes; between the two,
    fresh draws and beta_(j+1) = beta_j / gamma; the last stage passes. beta_1 = rest / stages and gamma = beta_1 **
    (1 / stages), so that each stage adds beta_1 to the false-alarm rate. Before the first stage ends, a sixteenth of
    its replicas are looked at: they can only fail, at a small share of the level, so that gross errors are found at
    once. A smaller one still is for the question whether each coordinate moves.
    """

    level: float = 1e-5
    stages: int = 4
    look: float = 0.09
    """The share of the level that is spent on the early look."""
    motion: float = 0.01
    """The share of the level for a coordinate that no replica has moved, and for replicas outside of the support."""

    def __post_init__(self):
        require(0 < self.level < 0.5, f"the level must lie between 0 and 0.5, not at {self.level}")
        require_whole(self.stages, "Scheme: stages")

    @property
    def early(self) -> float:
        """The combined p-value at or under which the look fails."""
        return self.level * self.look

    @property
    def first(self) -> float:
        """beta_1, what a failure at the first stage needs."""
        return self.level * (1 - self.look - self.motion) / self.stages

    @property
    def gamma(self) -> float:
        """The probability with which a right kernel goes on to another stage."""
        return self.first ** (1 / self.stages)

    def beta(self, stage: int) -> float:
        """What a failure at a stage (from 1 on) needs."""
        return self.first / self.gamma ** (stage - 1)

    def decide(self, stage: int, p: float) -> Literal["fail", "pass", "more"]:
        """What the combined p-value of a stage says."""
        beta = self.beta(stage)
        if p <= beta:
            return "fail"
        return "pass" if p > self.gamma + beta or stage == self.stages else "more"


@dataclass
class Ledger:
    """Deals out one family-wise false-alarm rate among the verifications of a run, however many there will be.

    The k-th gets total / (k (k + 1)), which sums to the total; or all alike, where their number is given. Shares are
    never given back.
    """

    total: float = 1e-4
    expected: int | None = None
    """How many verifications there will be; asking for more shares is an error."""
    spent: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        require(0 < self.total < 0.5, f"a ledger's total is a level between 0 and 0.5, not {self.total}")
        if self.expected is not None:
            require_whole(self.expected, "Ledger: expected")

    def share(self, name: str) -> float:
        """The level of the verification of this name; a name asks once."""
        require(
            name not in self.spent, f"the ledger has already dealt a share to {name!r}; give each a name of its own"
        )
        k = len(self.spent) + 1
        require(
            self.expected is None or k <= self.expected,
            f"the ledger was made for {self.expected} verifications, and {name!r} would be one more",
        )
        self.spent[name] = self.total / (k * (k + 1) if self.expected is None else self.expected)
        return self.spent[name]

    def __str__(self) -> str:
        lines = [f"  {level:.2e}  {name}" for name, level in self.spent.items()]
        return "\n".join([f"family-wise level {self.total:.1e}, spent {sum(self.spent.values()):.2e}:", *lines])
