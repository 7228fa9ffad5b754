"""Adaptive step size and large-step probability: adaptation that fades keeps the law, one that does not loses it."""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from experiments.support.verdict import verdict
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import SmallStep
from mcmc1d.numerics import cast, limit
from mcmc1d.random import uniforms
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import GaussianMixture
from mcmc1d.techniques import Uniform
from mcmc1d.verify import RingStep, enumerate_kernel, ring, step_operator
from mcmc1d.verify.goodness import cdf_gap, expected_distance, p_value, smallest_gap, total_variation

SOURCE = "Hachisuka et al. 2014, sec. 6"
THEORY = "Roberts, Rosenthal 2007"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    horizon: int = 100_000
    """Steps of the finite chains, whose law is computed."""
    chains: int = 2**17
    steps: int = 512
    bins: int = 32
    points: int = 2**20
    """Of the net that predicts the wrong law on the line."""
    level: float = 1e-6
    """Probability that a right law is rejected by one test."""
    agreement: float = 5e-3
    """Total variation up to which prediction and simulation agree, beyond the simulation's noise."""


PROFILES = {"quick": Config(), "paper": Config(horizon=1_000_000, chains=2**19, steps=2048, points=2**22)}

VALUES = np.array([1, 3, 0.5, 2, 4, 0.2, 1])
"""The density of a ring of seven."""
LARGE = (0.1, 0.5, 0.9)
KINDS = ("step size", "large-step probability")
LINE = GaussianMixture([0.2, 0.65], [0.05, 0.15], [0.5, 0.5])
"""A narrow mode and a broad one, which want different steps."""
WANTED = 0.5
"""The acceptance rate that is steered to."""
BOUNDS = (float(np.log(0.02)), float(np.log(0.5)))
"""Of the logarithm of the step size: without bounds, containment would have to be shown."""
GAINS = {"none": (0.0, 0.0), "fading": (2.0, 1.0), "not fading": (2.0, 0.0)}
"""The gain of step n is c / n^e."""
MARKS = 10.0


def accepted_or_not(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """(accepted, rejected) of every setting of what is adapted: the ring's matrices, (settings, n, n) each.

    From enumeration of this library's kernels. A step size is an offset of 1, 2 or 3 either way; a large step is
    uniform on the ring, and accepted where it leads nowhere.
    """
    n = len(VALUES)
    target, states = ring(VALUES)

    def matrix(move: RingStep) -> np.ndarray:
        return enumerate_kernel(move, target, states, probes=33).matrix

    off = 1 - np.eye(n)
    sizes = [matrix(RingStep(n, {k: 0.5, -k: 0.5})) for k in (1, 2, 3)]
    if kind == KINDS[0]:
        every, idle = sizes, [0.0] * len(sizes)
    else:
        large = matrix(RingStep(n, dict.fromkeys(range(n), 1 / n)))
        every, idle = [q * large + (1 - q) * sizes[0] for q in LARGE], [q / n for q in LARGE]
    accepted = np.stack([m * off + rest * np.eye(n) for m, rest in zip(every, idle, strict=True)])
    return accepted, np.stack(every) - accepted


def adaptive_chain(accepted: np.ndarray, rejected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The matrices on (setting, state): of a step after which the setting is adapted, and of one after which it stays.

    An accepted proposal raises the setting by one, a rejected one lowers it, as far as there are any.
    """
    settings, n = accepted.shape[:2]
    adapted, kept = np.zeros((settings, n, settings, n)), np.zeros((settings, n, settings, n))
    for s in range(settings):
        adapted[s, :, min(s + 1, settings - 1)] += accepted[s]
        adapted[s, :, max(s - 1, 0)] += rejected[s]
        kept[s, :, s] = accepted[s] + rejected[s]
    return adapted.reshape(settings * n, -1), kept.reshape(settings * n, -1)


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The finite chains' laws, computed; then the line, by simulation and by the operator."""
    pi = VALUES / VALUES.sum()
    marks = np.unique(np.round(MARKS ** np.arange(0, np.log10(config.horizon) + 0.01, 0.25)).astype(int))
    unfading, curves = [], []
    for kind in KINDS:
        adapted, kept = adaptive_chain(*accepted_or_not(kind))
        settings = len(adapted) // len(pi)
        start = np.zeros((settings, len(pi)))
        start[0] = pi
        laws = {}
        for name in ("fading", "not fading"):
            v, found = start.ravel(), []
            for n in range(1, marks[-1] + 1):
                v = v @ adapted if name == "not fading" else (v @ adapted + (n - 1) * (v @ kept)) / n
                if n in marks:
                    found.append(total_variation(v.reshape(settings, -1).sum(0), pi))
            laws[name] = v.reshape(settings, -1).sum(0)
            curves.append(found)
        unfading.append(laws["not fading"])
        progress("finite chains", KINDS.index(kind) + 1, len(KINDS))

    edges = np.linspace(0, 1, config.bins + 1)
    masses = LINE.bin_masses(edges)
    counts, sigmas, rates = [], [], []
    for k, gain in enumerate(GAINS.values()):
        x, log_sigma, rate = simulate(config, gain, jax.random.fold_in(jax.random.key(seed), k))
        counts.append(np.histogram(x, edges)[0])
        sigmas.append(float(np.exp(np.median(log_sigma))))
        rates.append(rate)
        progress("line", k + 1, len(GAINS))
    law = predicted(config, edges, seed)
    return xr.Dataset(
        {
            "pi": ("state", pi),
            "unfading": (("kind", "state"), np.stack(unfading)),
            "distance": (("kind", "adaptation", "step"), np.reshape(curves, (2, 2, -1))),
            "masses": ("bin", masses / masses.sum()),
            "counts": (("gain", "bin"), np.stack(counts)),
            "sigma": ("gain", sigmas),
            "rate": ("gain", rates),
            "p": ("gain", [p_value(c, masses) for c in counts]),
            "gap": ("gain", [cdf_gap(c, masses) for c in counts]),
            "predicted": ("bin", law),
            "detectable": smallest_gap(config.chains, config.level),
            "level": config.level,
            "agreement": config.agreement,
            "chains": config.chains,
            "steps": config.steps,
        },
        {
            "state": np.arange(len(pi)),
            "kind": list(KINDS),
            "adaptation": ["fading", "not fading"],
            "step": marks,
            "bin": (edges[1:] + edges[:-1]) / 2,
            "gain": list(GAINS),
        },
    )


def simulate(config: Config, gain: tuple[float, float], key: jax.Array) -> tuple[np.ndarray, np.ndarray, float]:
    """The last x and log step size of independent adaptive chains, started exactly; the last step's acceptance."""
    target = Multiplexed(LINE, Uniform())
    first, second = jax.random.split(key)
    start = mcmc1d.exact_start(first, target, config.chains)
    log_sigma = jnp.full(config.chains, np.log(0.1), start.u.dtype)
    factor, exponent = (jnp.asarray(part, start.u.dtype) for part in gain)
    found = _walk(second, cast(target, start.u.dtype), start, log_sigma, factor, exponent, jnp.asarray(config.steps))
    x, sizes, rate = (np.asarray(part) for part in found)
    return x, sizes, float(rate)


def _adapt(
    target: Multiplexed, state: State, log_sigma: Any, w: jax.Array, gain: jax.Array
) -> tuple[State, jax.Array, jax.Array]:
    """One step of the library's kernel, and the step size after it: up where the proposal was good, else down."""
    step = Metropolis(SmallStep(jnp.exp(log_sigma)), "plain").step(target, state, w)
    a = step.info.acceptance[0]
    return step.state, limit(log_sigma + gain * (a - WANTED), *BOUNDS), a


@eqx.filter_jit
def _walk(
    key: jax.Array, target: Multiplexed, start: State, log_sigma: Any, factor: Any, exponent: Any, steps: Any
) -> tuple[jax.Array, jax.Array, jax.Array]:
    def body(n: jax.Array, carry: Any) -> Any:
        state, size, _ = carry
        gain = factor / (n + 1.0) ** exponent
        w = uniforms(key, n, (2, size.shape[0]), size.dtype).T
        state, size, a = jax.vmap(lambda s, z, w: _adapt(target, s, z, w, gain.astype(z.dtype)))(state, size, w)
        return state, size, a.mean()

    first = (jax.vmap(target.evaluate)(State(start.index, start.u)), log_sigma, jnp.zeros((), log_sigma.dtype))
    state, size, rate = jax.lax.fori_loop(0, steps, body, first)
    return state.seen.x, size, rate


def predicted(config: Config, edges: np.ndarray, seed: int) -> np.ndarray:
    """The law of x that adaptation without fading keeps: (x, log sigma) is a Markov chain, and has an operator."""
    target, gain = Multiplexed(LINE, Uniform()), GAINS["not fading"][0]

    def step(key: jax.Array, z: jax.Array) -> jax.Array:
        own = cast(target, z.dtype)
        state = own.evaluate(State(jnp.zeros((), jnp.int32), z[:1]))
        w = jax.random.uniform(key, (2,), z.dtype)
        after, size, _ = _adapt(own, state, z[1], w, jnp.asarray(gain, z.dtype))
        return jnp.stack([after.seen.x, size])

    def log_density(z: jax.Array) -> jax.Array:
        return cast(LINE, z.dtype).log_f(z[0])

    lower, upper = [0.0, BOUNDS[0]], [1.0, BOUNDS[1]]
    operator = step_operator(
        step, log_density=log_density, lower=lower, upper=upper, cells=64, points=config.points, seed=seed
    )
    return operator.law_of(edges, lambda z: z[..., 0]).masses[0]


def draw(data: xr.Dataset) -> Figure:
    """The wrong laws on the ring, the distance from the law against the steps, and the wrong law on the line."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(7.0, 2.2))
    x = data.state.to_numpy()
    left.bar(x, data.pi, 0.8, color="0.8", label="exact")
    for kind, mark, colour in zip(data.kind.to_numpy(), "os", ("C1", "C3"), strict=True):
        left.plot(x, data.unfading.sel(kind=kind), mark, color=colour, markersize=3.5, label=f"adapts the {kind}")
    left.set(xlabel="state of the ring", ylabel="probability", ylim=(0, 0.62), title="adaptation that does not fade")
    left.legend()
    for kind, colour in zip(data.kind.to_numpy(), ("C1", "C3"), strict=True):
        for adaptation, style in (("not fading", "-"), ("fading", "--")):
            here = data.distance.sel(kind=kind, adaptation=adaptation)[1:]  # the first step starts exactly
            middle.plot(data.step[1:], here, style, color=colour, label=f"{kind}, {adaptation}")
    middle.set(xscale="log", yscale="log", xlabel="step n", ylabel="TV from the law", ylim=(1e-11, 1))
    middle.legend(loc="lower left")
    width = 1 / data.sizes["bin"]
    counts = data.counts.sel(gain="not fading").to_numpy()
    right.bar(data.bin, counts / counts.sum() / width, width, color="C1", alpha=0.5, linewidth=0, label="simulated")
    right.plot(data.bin, data.masses / width, color="black", linewidth=0.8, label="f / b")
    right.plot(data.bin, data.predicted / width, color="C3", linestyle=(0, (3, 1)), label="operator")
    right.set(xlabel="x", ylabel="density", title="step size, not fading, on the line")
    right.legend()
    return figure


def table(data: xr.Dataset) -> Table:
    """The line: final step size, acceptance, distance from the law."""
    result = Table(
        "adaptation", "step size", "acceptance", "TV", "CDF gap", "p", title="adaptation", box=SIMPLE, padding=0
    )
    for gain in data.gain.to_numpy():
        here = data.sel(gain=gain)
        distance = total_variation(here.counts.to_numpy() / here.counts.to_numpy().sum(), data.masses.to_numpy())
        cells = f"{float(here.sigma):.3f}", f"{float(here.rate):.3f}", f"{distance:.4f}", f"{float(here.gap):.4f}"
        result.add_row(str(gain), *cells, f"{float(here.p):.2g}")
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """What fades keeps the law, at a rate of 1 / n; what does not loses it, by as much as the operator says."""
    level, steps = float(data.level), int(data.steps)
    held = f"level {level:.0e}; detects a CDF gap of {float(data.detectable):.4f} after {steps} steps w.p. 0.99"
    final = {
        (k, a): float(data.distance.sel(kind=k, adaptation=a)[-1]) for k in KINDS for a in ("fading", "not fading")
    }
    horizon = int(data.step[-1])
    masses = data.masses.to_numpy()
    share = {str(g): c / c.sum() for g, c in zip(data.gain.to_numpy(), data.counts.to_numpy(), strict=True)}
    distance = {name: total_variation(law, masses) for name, law in share.items()}
    p = {str(g): float(data.p.sel(gain=g)) for g in data.gain.to_numpy()}
    apart = total_variation(share["not fading"], data.predicted.to_numpy())
    noise = expected_distance(np.sqrt(masses * (1 - masses) / float(data.chains)))

    def slope(kind: str) -> float:
        late = data.step.to_numpy() >= 100
        here = data.distance.sel(kind=kind, adaptation="fading").to_numpy()[late]
        return float(np.polyfit(np.log(data.step.to_numpy()[late]), np.log(here), 1)[0])

    slopes = [slope(kind) for kind in KINDS]
    return [
        Claim(
            "adaptation.fading",
            "A step size that is adapted less and less (gain 1 / n, bounded) keeps the law",
            f"{SOURCE}; {THEORY}",
            verdict(final[KINDS[0], "fading"] < 1e-4 and p["fading"] >= level),
            "holds",
            f"ring: TV {final[KINDS[0], 'fading']:.1e} after {horizon} steps; line: TV {distance['fading']:.4f}, "
            f"p {p['fading']:.2g} (no adaptation: p {p['none']:.2g})",
            f"computed, 1e-4; {held}",
        ),
        Claim(
            "adaptation.not-fading",
            "A step size may go on adapting with a constant gain",
            f"ours; {THEORY}",
            verdict(final[KINDS[0], "not fading"] < 1e-4 and p["not fading"] >= level),
            "fails",
            f"ring: TV {final[KINDS[0], 'not fading']:.4f}; line: TV {distance['not fading']:.4f}, "
            f"p {'under 1e-300' if p['not fading'] < 1e-300 else format(p['not fading'], '.1g')}",
            f"computed, 1e-4; {held}",
        ),
        Claim(
            "adaptation.large-fading",
            "A large-step probability that is adapted less and less keeps the law",
            f"{SOURCE}; {THEORY}",
            verdict(final[KINDS[1], "fading"] < 1e-4),
            "holds",
            f"ring: TV {final[KINDS[1], 'fading']:.1e} after {horizon} steps",
            "computed, 1e-4",
        ),
        Claim(
            "adaptation.large-not-fading",
            "A large-step probability may go on adapting",
            f"ours; {THEORY}",
            verdict(final[KINDS[1], "not fading"] < 1e-4),
            "fails",
            f"ring: TV {final[KINDS[1], 'not fading']:.4f}",
            "computed, 1e-4",
        ),
        Claim(
            "adaptation.rate",
            "The bias of fading adaptation falls as its gain, 1 / n",
            f"ours; {THEORY}",
            verdict(max(abs(s + 1) for s in slopes) < 0.1),
            "holds",
            f"TV falls as n^{slopes[0]:.3f} and n^{slopes[1]:.3f}",
            "exponent within 0.1 of -1; computed laws from step 100 on",
        ),
        Claim(
            "adaptation.operator",
            "The operator on (x, step size) predicts the law that adaptation without fading has",
            "ours",
            verdict(apart < float(data.agreement) + 2 * noise),
            "holds",
            f"TV {apart:.4f} between predicted and simulated, {distance['not fading']:.4f} from f / b",
            f"TV {float(data.agreement):.0e} beyond twice the simulation's noise, {noise:.4f}",
        ),
    ]
