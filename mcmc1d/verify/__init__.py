"""Verification: deterministic contracts of techniques and moves."""

from mcmc1d.verify.move import check_move, hard_target
from mcmc1d.verify.report import Check, ContractError, Report
from mcmc1d.verify.technique import check_technique

__all__ = ["Check", "ContractError", "Report", "check_move", "check_technique", "hard_target"]
