"""Mistakes that leave the law right: only acceptance, or how fast the chain mixes, tells."""

from mcmc1d.moves import ExponentialStep, Mixture, Move, ReversibleJump, SmallStep
from mcmc1d.verify.move import hard_target
from mcmc1d.verify.mutants import Mutant
from mcmc1d.verify.mutants.jumps import Frozen


def mixed(jump: Move) -> Mixture:
    """A small step or a jump."""
    return Mixture({"small": (0.5, SmallStep(0.1)), "jump": (0.5, jump)})


MUTANTS = {
    "exponent_of_the_step_size": Mutant(
        # s2 exp(+log(s2 / s1) r) in place of s2 exp(-log(s2 / s1) r): steps of 1/64 to 1/4, symmetric all the same.
        ExponentialStep(1 / 64, 1 / 4),
        "sign of the exponent in the mutation size",
        "Tungsten 5329790",
        layer="efficiency",
        law=hard_target(),
        options={"ergodic": False},
        right=ExponentialStep(1 / 1024, 1 / 64),
    ),
    "jump_that_never_fires": Mutant(
        mixed(Frozen(ReversibleJump())),
        "the move's selection test omits its offset: the move never fires",
        "Tungsten 5ea3909",
        layer="efficiency",
        law=hard_target(),
        options={"ergodic": False},
        right=mixed(ReversibleJump()),
    ),
}
