"""Every mutant through the production settings of every layer: what catches what, and how small a mistake still is."""

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from mcmc1d.checks import require
from mcmc1d.moves import Mixture, Move, ReversibleJump, SmallStep
from mcmc1d.targets import GaussianMixture
from mcmc1d.techniques import Technique, Tent
from mcmc1d.verify import (
    LawError,
    Report,
    Verdict,
    check_move,
    check_technique,
    efficiency,
    hard_target,
    laws,
    verify,
)
from mcmc1d.verify.mutants import LAYERS, Mutant, mutants, traps
from mcmc1d.verify.mutants.langevin import mala


@dataclass(frozen=True)
class Config:
    """The experiment's numbers; `verify` runs at its own defaults, but for its time."""

    seeds: int = 1
    """Seeds a mutant: caught at 59 of 59, its power is at least 0.95 with 95 % confidence (0.95^59 < 0.05)."""
    trap_seeds: int = 1
    sweep_seeds: int = 1
    """Seeds a severity of the power curve."""
    every: int = 4
    """Every so many mutants and traps; 1 is all of them, as in the tests."""
    full: bool = False
    """Also the chains of which wrong moves are a part, and the severities that no claim is about."""

    def __post_init__(self) -> None:
        require(self.every >= 1, f"every is a whole number from 1 on, not {self.every}")


PROFILES = {"quick": Config(), "paper": Config(seeds=59, trap_seeds=3, sweep_seeds=6, every=1, full=True)}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

SEVERITIES = (-0.4, -0.2, -0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2, 0.4)
"""eps: the log correction of a MALA kernel is multiplied by 1 + eps."""

CLAIMED = (-0.2, 0.0, 0.2)

SECONDS = 120.0
"""`verify`'s first stages may take this long: what its default of 40 buys on two idle cores, on one that is shared."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Catch the mutants, let the traps pass, and sweep one mistake's severity.

    `caught` is a share of the seeds; of a mutant that contracts must catch, the other layers' entries are of the chain
    that it is a part of, at one seed, and so 0 or 1.
    """
    wrong = dict(list(mutants().items())[:: config.every])
    right = dict(list(traps().items())[:: config.every])
    severities = SEVERITIES if config.full else CLAIMED
    layers = progress.map("mutants", catches, [(name, seed, config.seeds, config.full) for name in wrong])
    caught = np.array([[[layer in found for layer in LAYERS] for found in seeds] for seeds, _ in layers])
    beside = np.array([[layer in also for layer in LAYERS] for _, also in layers])
    passed = np.array(progress.map("traps", passes, [(name, seed, config.trap_seeds) for name in right]))
    found = np.array(progress.map("severity", rejections, [(eps, seed, config.sweep_seeds) for eps in severities]))
    return xr.Dataset(
        {
            "caught": (("mutant", "layer"), (caught | beside[:, None]).mean(1)),
            "killed": ("mutant", caught.any(-1).mean(1)),
            "must": ("mutant", [mutant.layer for mutant in wrong.values()]),
            "origin": ("mutant", [mutant.origin for mutant in wrong.values()]),
            "mistake": ("mutant", [mutant.mistake for mutant in wrong.values()]),
            "passed": ("trap", passed / config.trap_seeds),
            "power": ("severity", found / config.sweep_seeds),
            "seeds": config.seeds,
            "trap_seeds": config.trap_seeds,
            "sweep_seeds": config.sweep_seeds,
        },
        {"mutant": list(wrong), "layer": list(LAYERS), "trap": list(right), "severity": list(severities)},
    )


def catches(name: str, seed: int, seeds: int, full: bool) -> tuple[list[list[str]], list[str]]:
    """The layers that catch a mutant, at each seed; if `full`, those that catch the chain it is a part of, at one."""
    mutant = mutants()[name]
    beside = chain(mutant, seed) if full and mutant.layer == "contract" else set()
    return [sorted(catch(mutant, seed + k)) for k in range(seeds)], sorted(beside)


def passes(name: str, seed: int, seeds: int) -> int:
    """At how many seeds a trap passes."""
    trap = traps()[name]
    return sum(
        verify(trap.subject, trap.law, seed=seed + k, **{"seconds": SECONDS, **trap.options}).passed
        for k in range(seeds)
    )


def rejections(eps: float, seed: int, seeds: int) -> int:
    """At how many seeds a MALA kernel fails whose log correction is multiplied by 1 + eps."""
    law = laws.two_modes()
    kernel = mala(law, 0.1, 1 + eps)
    reports = [verify(kernel, law, seed=seed + k, reversible=True, seconds=SECONDS) for k in range(seeds)]
    return sum(report.verdict is Verdict.FAIL for report in reports)


def catch(mutant: Mutant, seed: int) -> set[str]:
    """The layers that catch a mutant at one seed."""
    subject = mutant.subject
    if mutant.layer == "contract":
        check = (
            check_technique(subject, seed=seed) if isinstance(subject, Technique) else check_move(subject, seed=seed)
        )
        return set() if check else {"contract"}
    layers = convictions(verify(subject, mutant.law, seed=seed, **{"seconds": SECONDS, **mutant.options}))
    if mutant.layer == "efficiency" and not efficiency(subject, mutant.right, mutant.law, seed=seed).alike:
        layers.add("efficiency")
    return layers


def chain(mutant: Mutant, seed: int) -> set[str]:
    """The layers that catch a chain of which a wrong technique or move is a part."""
    if isinstance(mutant.subject, Move):
        move = Mixture({"small": (0.5, SmallStep(0.1)), "mutant": (0.5, mutant.subject)})
        return convictions(verify(move, hard_target(), seed=seed))
    hard = GaussianMixture([-0.02, 0.45, 1.0], [0.08, 0.05, 0.12], [0.5, 0.2, 0.3])
    try:
        target = mcmc1d.Multiplexed(hard, (Tent(0.4), mutant.subject))
    except ValueError:  # its density is refused
        return {"law"}
    move = Mixture({"small": (0.5, SmallStep(0.1)), "jump": (0.5, ReversibleJump())})
    try:
        return convictions(verify(move, target, seed=seed))
    except LawError:  # its samples do not have its density
        return {"law"}


def convictions(report: Report) -> set[str]:
    """The layers of the tests that fail; "motion" where it does not move, leaves the support or does not forget."""
    if report.verdict is Verdict.FAIL:
        layers = {failure.layer for failure in report.failures}
        left = any("leave the support" in reason for reason in report.reasons)
        return layers | {"motion"} if left or not layers else layers
    return {"motion"} if any("has not forgotten" in reason for reason in report.reasons) else set()


def draw(data: xr.Dataset) -> Figure:
    """The kill matrix, and the power curve of one mistake."""
    names, layers = data.mutant.to_numpy(), data.layer.to_numpy()
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.0, 0.115 * len(names) + 0.9), gridspec_kw={"width_ratios": (1.3, 1)}
    )
    order = np.lexsort((names, [list(layers).index(layer) for layer in data.must.to_numpy()]))
    # To 1, and in the paler part of the map, on which the squares are seen.
    shades = ListedColormap(plt.get_cmap("Blues")(np.linspace(0, 0.75, 256)))
    shown = left.imshow(
        data.caught.to_numpy()[order], aspect="auto", cmap=shades, vmin=0, vmax=1, interpolation="nearest"
    )
    must = [list(layers).index(layer) for layer in data.must.to_numpy()[order]]
    left.plot(must, np.arange(len(names)), "s", markersize=3.2, markerfacecolor="none", markeredgecolor="C1")
    left.set_yticks(np.arange(len(names)), [str(name).replace("_", " ") for name in names[order]], fontsize=5)
    left.set_xticks(np.arange(len(layers)), list(layers), rotation=40, ha="right", fontsize=6)
    left.set_xticks(np.arange(len(layers)) - 0.5, minor=True)
    left.grid(which="minor", axis="x", color="white")
    left.tick_params(which="both", length=0)
    left.set_title("caught by (square: must)", fontsize=7)
    bar = figure.colorbar(shown, ax=left, orientation="horizontal", aspect=40, pad=0.01)
    bar.set_label(
        f"share of {int(data.seeds)} seeds; where contract must,\nof others the verdict on its chain at one seed",
        fontsize=6,
    )
    right.axhline(0.99, color="0.8", linewidth=0.6)
    right.plot(data.severity, data.power, "o-", markersize=3)
    right.set(xlabel="ε: MALA's log correction times 1 + ε", ylabel="rejected", ylim=(-0.03, 1.03))
    right.set_xscale("symlog", linthresh=0.02, linscale=0.6)
    right.set_xticks(
        [-0.4, -0.1, -0.02, 0, 0.02, 0.1, 0.4], ["−0.4", "−0.1", "−0.02", "0", "0.02", "0.1", "0.4"], fontsize=6
    )
    right.minorticks_off()
    right.set_title(f"power against severity ({int(data.sweep_seeds)} seeds)", fontsize=7)
    right.set_box_aspect(0.8)
    right.set_anchor("N")
    return figure


def table(data: xr.Dataset) -> Table:
    """Each mutant, what must catch it, and what does."""
    result = Table("mutant", "must", "killed", "by", title="kill_matrix", box=SIMPLE, padding=0)
    for k, name in enumerate(data.mutant.to_numpy()):
        here = data.isel(mutant=k)
        by = [str(layer) for layer in data.layer.to_numpy() if float(here.caught.sel(layer=layer)) > 0]
        result.add_row(str(name), str(here.must.to_numpy()), f"{float(here.killed):.0%}", ", ".join(by))
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Every mutant is caught, by the layer that must; no trap is."""
    seeds, count = int(data.seeds), data.sizes["mutant"]
    required = np.array(
        [float(data.caught.sel(mutant=m, layer=str(data.must.sel(mutant=m).to_numpy()))) for m in data.mutant]
    )
    survivors = [str(m) for m in data.mutant.to_numpy()[data.killed.to_numpy() < 1]]
    missed = [str(m) for m in data.mutant.to_numpy()[required < 1]]
    failing = [str(t) for t in data.trap.to_numpy()[data.passed.to_numpy() < 1]]
    power = 0.05 ** (1 / seeds)
    return [
        Claim(
            "verify.mutants",
            f"Each of {count} wrong kernels, moves and techniques, singly, is caught",
            "ours; origins in mcmc1d.verify.mutants",
            "fails" if survivors else "holds",
            "holds",
            f"{count - len(survivors)} of {count} at every seed"
            + (f"; not {', '.join(survivors)}" if survivors else ""),
            f"{seeds} of {seeds} seeds: power over {power:.2f} with 95 % confidence",
        ),
        Claim(
            "verify.layers",
            "Each is caught by the layer that must catch it",
            "ours",
            "fails" if missed else "holds",
            "holds",
            f"{count - len(missed)} of {count}" + (f"; not {', '.join(missed)}" if missed else ""),
            f"{seeds} of {seeds} seeds",
        ),
        Claim(
            "verify.traps",
            "Right kernels that look wrong pass",
            "ours",
            "fails" if failing else "holds",
            "holds",
            f"{data.sizes['trap'] - len(failing)} of {data.sizes['trap']} at every seed"
            + (f"; not {', '.join(failing)}" if failing else ""),
            f"{int(data.trap_seeds)} seeds; level 1e-5 each",
        ),
        Claim(
            "verify.power",
            "A log correction that is 20 % off is caught, a right one passes",
            "ours; after blackjax #653",
            "holds"
            if float(data.power.sel(severity=[eps for eps in CLAIMED if eps]).min()) == 1
            and float(data.power.sel(severity=0.0)) == 0
            else "fails",
            "holds",
            f"rejected {data.power.to_numpy().round(2).tolist()} at eps {data.severity.to_numpy().tolist()}",
            f"{int(data.sweep_seeds)} seeds; level 1e-5",
        ),
    ]
