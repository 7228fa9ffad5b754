"""Verification: contracts of techniques and moves, and a verdict with an error rate on any kernel."""

from mcmc1d.verify import laws, mutants
from mcmc1d.verify.adapters import blackjax, emcee, numpyro
from mcmc1d.verify.contract import Check, ContractError, ContractReport
from mcmc1d.verify.efficiency import Efficiency, efficiency
from mcmc1d.verify.engine import verify
from mcmc1d.verify.finite import Enumeration, RingStep, enumerate_kernel, ring
from mcmc1d.verify.kernels import HostKernel, JaxKernel
from mcmc1d.verify.law import Law, LawError
from mcmc1d.verify.ledger import Ledger, Scheme
from mcmc1d.verify.move import check_move, hard_target
from mcmc1d.verify.net import DepositLaw, deposit_law
from mcmc1d.verify.operator import Operator, step_operator, transition_operator
from mcmc1d.verify.report import Report, Result, Verdict, VerificationError
from mcmc1d.verify.statistic import Continuous, Discrete
from mcmc1d.verify.technique import check_technique

__all__ = [
    "Check",
    "Continuous",
    "ContractError",
    "ContractReport",
    "DepositLaw",
    "Discrete",
    "Efficiency",
    "Enumeration",
    "HostKernel",
    "JaxKernel",
    "Law",
    "LawError",
    "Ledger",
    "Operator",
    "Report",
    "Result",
    "RingStep",
    "Scheme",
    "Verdict",
    "VerificationError",
    "blackjax",
    "check_move",
    "check_technique",
    "deposit_law",
    "efficiency",
    "emcee",
    "enumerate_kernel",
    "hard_target",
    "laws",
    "mutants",
    "numpyro",
    "ring",
    "step_operator",
    "transition_operator",
    "verify",
]
