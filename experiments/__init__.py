"""Reproduction experiments: one file a figure or table of a paper.

An experiment is a module of this folder with `Config` (a frozen dataclass), `PROFILES`, `run`, `draw`, `table` and
`judge`; `python -m experiments` finds it there.
"""
