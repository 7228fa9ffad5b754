"""The kernels behind the theories' claims about a law: each with its target, what theory says of it, and its parts."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from experiments import cmlt_sigma_p, importance_functions, mtm_lambda, planar, rjmlt_fig3, rjmlt_inverses
from experiments import mmlt_marginals as multiplexing
from experiments import tempering as ladders
from experiments.support.beyond_rjmlt_dimensions import RIGHT, TRANSDIMENSIONAL
from experiments.support.beyond_rjmlt_dimensions import kernels as dimension_jumps
from experiments.support.beyond_rjmlt_pairs import pairs
from experiments.support.beyond_rjmlt_scaled import SMOOTH, TECHNIQUES, UnaccountedStep
from mcmc1d import tempering
from mcmc1d.checks import require_instance
from mcmc1d.metropolis import Kernel
from mcmc1d.moves import LargeStep, Mixture, Move, MultipleTry, ReversibleJump, SmallStep, StepAndChange, TruncatedStep
from mcmc1d.moves.exchange import CoordinateStep, Exchange
from mcmc1d.moves.multiple_try import evenly
from mcmc1d.moves.scaled import ScaledStep
from mcmc1d.packets import AuxiliaryCentre, PublishedDeposit
from mcmc1d.pooled import Floored, floored, samples
from mcmc1d.state import Multiplexed
from mcmc1d.subchain import SplitSample, SubChain
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Tent, Uniform
from mcmc1d.techniques.gaussian import BoxMuller
from mcmc1d.verify.mutants.steps import ClampedStep
from mcmc1d.weights import Balance, PathSpace


class Case(NamedTuple):
    """A kernel of which theory says whether it keeps its target's law, or deposits samples of it."""

    claims: str
    """The claim, as the table of claims has it."""
    kernel: Move | Kernel
    target: Multiplexed
    keeps: bool = True
    parts: tuple[Move, ...] = ()
    """The moves that a kernel with deposits of its own is made of: their contracts count, and its deposits' law."""
    of: Callable[[np.ndarray], np.ndarray] | None = None
    """The coordinate whose law is computed, of points of several."""
    exact: Callable[[np.ndarray], np.ndarray] | None = None
    """Its masses between edges; those of x unless given."""
    edges: tuple[float, float] = (0.0, 1.0)


LINE = Multiplexed(Sinusoid(0.9, 2.0, 0.1), Uniform())


def cases() -> dict[str, Case]:
    """By name, theory after theory, the wrong beside the right."""
    return {**_multiplexing(), **_tempering(), **_multiple_try(), **_deposits(), **_jumps(), **_beyond(), **_others()}


def _multiplexing() -> dict[str, Case]:
    f, techniques, step = multiplexing.F, multiplexing.TECHNIQUES, StepAndChange(SmallStep(0.1))
    each = {name: Multiplexed(f, techniques, weights) for name, weights in multiplexing.HEURISTICS.items()}
    naive = Multiplexed(f, (Uniform(),) * 3, PathSpace(Balance(), techniques))
    floor = floored(each["balance"])
    own = require_instance(floor.target, Floored, "the target of the floored index")

    def floored_case(claim: str, move: Move) -> Case:
        return Case(claim, move, floor, of=lambda u: samples(own, u), exact=f.bin_masses)

    return {
        **{f"multiplexed, {name}": Case("mmlt.marginal", step, target) for name, target in each.items()},
        "path space": Case("mmlt.path-space", step, naive),
        "index as a floor": floored_case("mmlt.floor-index", SmallStep(0.1)),
        "block-wise": floored_case("mmlt.block-wise", CoordinateStep(0.3)),
    }


def _tempering() -> dict[str, Case]:
    gentle, step = ladders.GENTLE, StepAndChange(SmallStep(0.2))
    pair = tempering.replicas(gentle, (1.0, 0.2))
    swap = Mixture({"step": (0.7, CoordinateStep(0.2)), "swap": (0.3, Exchange())})
    return {
        **{
            f"ladder, {name} prior": Case(
                "tempering.any-prior", step, tempering.ladder(gentle, ladders.BETAS, log_prior=prior)
            )
            for name, prior in ladders.PRIORS.items()
        },
        "replica exchange": Case(
            "tempering.replica-exchange", swap, pair, of=lambda x: x[..., 0], exact=gentle.bin_masses
        ),
    }


_TRIED = {
    "right": ("mtm.symmetric-lambda", "symmetric lambda, strata"),
    "no normaliser": ("mtm.clamped-without", "clamped, no normaliser"),
    "lambda not symmetric": ("mtm.asymmetric-lambda", "R_g, lambda not symmetric"),
    "other strata": ("mtm.strata-all-but-chosen", "all strata but the chosen"),
    "fresh competitors": ("mtm.quasi-random-independent", "quasi-random, fresh competitors"),
    "rotated": ("mtm.quasi-random-rotated", "quasi-random, rotated"),
    "fresh opposite": ("mtm.antithetic-independent", "antithetic, fresh competitor"),
    "antithetic": ("mtm.antithetic-opposite", "antithetic, opposite competitor"),
    "even weights": ("mtm.intervals", "even weights, intervals"),
}


def _multiple_try() -> dict[str, Case]:
    tried = mtm_lambda.moves_on_the_line(0.2)
    right = ("right", "rotated", "antithetic", "even weights")
    made = {text: Case(claim, tried[name], mtm_lambda.LINE, name in right) for name, (claim, text) in _TRIED.items()}
    clamped = TruncatedStep(0.2)
    return {"clamped, with its normaliser": Case("mtm.clamped-with", clamped, mtm_lambda.LINE), **made}


def _deposits() -> dict[str, Case]:
    small, large = SmallStep(0.15), LargeStep()
    packet, evenly_chosen = MultipleTry(small, 4), MultipleTry(small, 4, evenly)
    sub, split = SubChain(large, small, 2), SplitSample(small, 3)
    return {
        "two states of a packet": Case("cmlt.repair", packet, LINE),
        "auxiliary centre": Case("cmlt.repair", AuxiliaryCentre(small, 4), LINE, parts=(small,)),
        "all of a packet": Case("cmlt.deposit-unbiased", PublishedDeposit(packet), LINE, False, parts=(packet,)),
        "all of a packet, chosen evenly": Case(
            "cmlt.deposit-even", PublishedDeposit(evenly_chosen), LINE, parts=(evenly_chosen,)
        ),
        "sub-chain": Case("cmlt.sub-chain", sub, LINE, parts=(large, small)),
        "sub-chain from the proposal": Case(
            "cmlt.sub-chain-proposal", cmlt_sigma_p.FromTheProposal(sub, large), LINE, False, parts=(large, small)
        ),
        "split sample": Case("cmlt.split", split, LINE, parts=(small,)),
        "split, nothing kept": Case(
            "cmlt.split-nothing-kept", cmlt_sigma_p.NothingKept(split), LINE, False, parts=(small,)
        ),
    }


def _jumps() -> dict[str, Case]:
    claims = {
        "multiplexed": "multiplexed",
        "no Jacobian": "no-jacobian",
        "fixed point": "fixed-point",
        "full": "full",
        "full, aimed": "full-aimed",
    }
    right = rjmlt_fig3.RIGHT
    figure = {}
    for name in right:
        target, move = rjmlt_fig3.integrator(rjmlt_fig3.Config(), name)
        figure[f"figure 3, {name}"] = Case(f"rjmlt.{claims[name]}", move, target, right[name])
    inverses = rjmlt_inverses

    def chain(jump: Move) -> Move:
        return inverses.chain(0.1, jump)

    nested = Multiplexed(inverses.F, (Tent(0.4), inverses.STEP, inverses.NESTED))
    lobes = {
        f"lobe {name}": Case(
            "rjmlt.lobe-wrong-ratio" if "1 / p" in name else "rjmlt.lobe-any-choice",
            chain(ReversibleJump()),
            Multiplexed(inverses.F, (Tent(0.4), technique)),
            "1 / p" not in name,
        )
        for name, technique in inverses.LOBES.items()
    }
    return {
        **figure,
        "nested mixtures": Case("rjmlt.nested-mixtures", chain(ReversibleJump(inverses.T)), nested),
        **lobes,
        "inversion fails there": Case(
            "rjmlt.failed-inversions", chain(inverses.FAILS["there"]), inverses.BRITTLE, False
        ),
        "inversion fails there or back": Case(
            "rjmlt.failed-there-and-back", chain(inverses.FAILS["there and back"]), inverses.BRITTLE
        ),
    }


def _beyond() -> dict[str, Case]:
    smooth = Multiplexed(SMOOTH, TECHNIQUES["poor match"])
    banana, move = pairs(BoxMuller((0.0, 0.3), 0.8))
    plane, line_and_square = banana.target, TRANSDIMENSIONAL.target
    claims = {
        "same numbers": "jump-numbers",
        "same x": "jump-x",
        "same numbers, no p": "jump-numbers-no-p",
        "same x, no stretch": "jump-x-no-stretch",
    }
    between = {
        f"line and square, {name}": Case(
            f"beyond.{claims[name]}",
            jump,
            TRANSDIMENSIONAL,
            name in RIGHT,
            of=lambda x: x[..., 0],
            exact=lambda edges: line_and_square.bin_masses((edges, np.array([0.0, 1.0])))[:, 0],
            edges=(0.0, 2.0),
        )
        for name, jump in dimension_jumps().items()
    }
    lower, upper = plane.domain
    return {
        **between,
        "Box-Muller": Case(
            "beyond.box-muller",
            move,
            banana,
            of=lambda x: x[..., 0],
            exact=lambda edges: plane.bin_masses((edges, np.array([lower[1], upper[1]])))[:, 0],
            edges=(float(lower[0]), float(upper[0])),
        ),
        "step by the Jacobian": Case("beyond.scaled-step", ScaledStep(0.15), smooth),
        "taken for symmetric": Case("beyond.scaled-symmetric", UnaccountedStep(ScaledStep(0.15)), smooth, False),
    }


def _others() -> dict[str, Case]:
    importance = importance_functions.functions(LINE.target)
    plane = {
        f"{place}, {name}": Case(
            f"planar.{name.lower().replace(' ', '-')}-{place}",
            planar.moves(planar.Config())[name],
            planar.multiplexed(planar.TARGETS[place]),
            "Jacobian" not in name,
            of=lambda x: x[..., 0],
            exact=lambda edges, place=place: planar.TARGETS[place].bin_masses((edges, np.array([0.0, 1.0])))[:, 0],
        )
        for place, name in planar.CASES
    }
    return {
        **{
            f"importance, {name}": Case("imp.unbiased-exact", SmallStep(0.15), Multiplexed(importance[name], Uniform()))
            for name in ("shader", "f over regions", "chained")
        },
        "wrapped": Case("pss.wrap", SmallStep(0.1), LINE),
        "clamped": Case("pss.clamp", ClampedStep(), LINE, False),
        **plane,
    }
