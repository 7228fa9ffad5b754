"""Metropolis with any importance function: unbiased, what it moves, what it loses, and why a constant is no good."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table
from scipy.stats import sem

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.long import long_run
from experiments.support.scenes import glints, walk
from experiments.support.sweep import Sweep
from mcmc1d.image import Film, Image
from mcmc1d.importance import Floor, Product, Regions, Shader, lost_mass
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import LargeStep, Mixture, SmallStep
from mcmc1d.perception import density_statistics, error
from mcmc1d.pixels import Pixels, pixel_values
from mcmc1d.redistribution import independent
from mcmc1d.rendering import Renderer
from mcmc1d.targets import FromFunction, Sinusoid, Tabulated, Target
from mcmc1d.techniques import Uniform
from mcmc1d.verify import RingStep, enumerate_kernel, ring

PAPER = "Hoberock and Hart 2010"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    pixels: int = 20
    chains: int = 4096
    steps: int = 512
    sigma: float = 0.15
    blocks: int = 32
    """Of chains, each with an image of its own."""
    replicas: int = 16
    """Images of the scene with hidden coordinates."""
    samples: int = 2**15
    """Of each of those."""


PROFILES = {"quick": Config(), "paper": Config(steps=8192, replicas=50, samples=2**17)}

SHADED = (0.5, 0.75)
"""Where the shader multiplies by ten: over a trough and a crest."""


def _shaded(x):
    return (x > SHADED[0]) & (x < SHADED[1])


def functions(f: Target) -> dict[str, Target]:
    """The importance functions compared; the last one vanishes where f does not."""
    coarse = f.bin_masses(np.linspace(0, 1, 6))
    over = Regions(1 / coarse)
    return {
        "f": f,
        "constant": FromFunction(jnp.ones_like),
        "shader": Shader(f, _shaded, 10.0, SHADED),
        "floor": Floor(f, 0.6),
        "f over regions": Product((f, over)),
        "chained": Product((Floor(f, 0.3), Shader(over, _shaded, 4.0, SHADED))),
        "vanishing": Product((f, Regions([1, 2, 0, 1, 3]))),
    }


UNBIASED = ("f", "constant", "shader", "floor", "f over regions", "chained")


def on_a_ring() -> float:
    """The largest relative bias of a state's deposits by enumeration, over random and composed importance functions."""
    values = np.array([1.0, 3.0, 0.5, 2.0, 4.0])
    f, step, (_, states) = Tabulated(values), RingStep(5, {1: 0.75, -1: 0.25}), ring(values)
    rng, worst = np.random.default_rng(0), 0.0
    over = Regions(rng.uniform(0.1, 3, 5))
    for importance in (over, Product((f, over)), Product((Floor(f, 1.5), Shader(over, _shaded, 10.0)))):
        found = enumerate_kernel(Metropolis(step), mcmc1d.Multiplexed(importance, Uniform()), states)
        with jax.enable_x64(True):
            at = jnp.asarray(states.u[:, 0])
            log_i, log_f = (np.asarray(jax.vmap(t.log_f)(at)) for t in (importance, f))
        b = np.exp(log_i).mean()
        image = b * (found.law @ found.deposits) * np.exp(log_f - log_i)
        worst = max(worst, float(np.abs(image / np.exp(log_f) * len(values) - 1).max()))
    return worst


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Images of a line by each importance function; then a constant one where paths are hidden."""
    key = jax.random.key(seed)
    f, pixels = Sinusoid(0.9, 2.0, 0.1), Pixels(config.pixels)
    exact, whole = pixel_values(f, pixels), np.array([0.0, 1.0])
    chosen = functions(f)
    names = list(chosen)
    size = (len(names), config.blocks, config.pixels)
    images, densities, rates = np.zeros(size), np.zeros(size), np.zeros(len(names))
    for k, (name, importance) in enumerate(chosen.items()):
        found = long_run(
            f"image, {name}",
            jax.random.fold_in(key, k),
            Mixture({"small": (0.9, SmallStep(config.sigma)), "large": (0.1, LargeStep())}),
            mcmc1d.Multiplexed(importance, Uniform()),
            steps=config.steps,
            chains=config.chains,
            blocks=config.blocks,
            estimators={
                "image": Image(f, importance, pixels, allow_loss=name == "vanishing"),
                "acceptance": mcmc1d.Acceptance(),
            },
        )
        b = float(importance.bin_masses(whole)[0])
        film = Film.of(found.sums["image"], np.full(config.blocks, b), config.steps * config.chains / config.blocks)
        images[k], densities[k] = film.image(), film.density / film.density.mean(1, keepdims=True)
        accepted, proposed = (s.sum() for s in found.sums["acceptance"])
        rates[k] = accepted / proposed
        progress("importance functions", k + 1, len(names))
    shaded = lost_mass(f, Shader(f, _shaded, 0.0, SHADED))
    hidden = _constant(config, jax.random.fold_in(key, 100))
    progress("hidden coordinates", 1, 1)
    return xr.Dataset(
        {
            "exact": ("pixel", exact),
            "image": (("importance", "block", "pixel"), images),
            "density": (("importance", "block", "pixel"), densities),
            "acceptance": ("importance", rates),
            "enumerated": on_a_ring(),
            "lost": lost_mass(f, chosen["vanishing"])[0],
            "shaded": shaded[0] / shaded[1],
            "stratified": (("kind", "replica"), hidden["variance"]),
            "hidden_error": (("kind", "replica"), hidden["error"]),
            "spp": config.samples / (glints().pixels.count - 1),  # 1 / spp is the variance of a multinomial's counts
        },
        {"importance": names, "kind": ["constant, large steps", "constant, walk", "f, walk", "independent"]},
    )


def _constant(config: Config, key) -> dict[str, np.ndarray]:
    """The scene with hidden coordinates: the variance of the sample density and the error, constant I against f."""
    scene = glints()
    exact, flat, hard = scene.exact(), glints(importance=Regions([1.0], hidden=1)), walk()
    films = []
    for k, (what, move) in enumerate(((flat, LargeStep()), (flat, hard), (scene, hard))):
        renderer = Renderer(what, move, config.replicas, 4)
        films.append(renderer.plain(jax.random.fold_in(key, k), config.samples).film)
    films.append(independent(jax.random.fold_in(key, 9), scene, config.samples, config.replicas).film)
    return {
        "variance": np.stack([density_statistics(film.density).variance for film in films]),
        "error": np.stack([error(film.image(), exact) for film in films]),
    }


def draw(data: xr.Dataset) -> Figure:
    """Where the samples go; whether the image is right; how much each pixel's error is."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(7.0, 2.1))
    exact = data.exact.to_numpy()
    n = exact.size
    x, blocks = (np.arange(n) + 0.5) / n, data.sizes["block"]
    left.stairs(exact, np.linspace(0, 1, n + 1), color="0.75", fill=True, label="exact image")
    colours = {"f": "C0", "constant": "C3", "shader": "C1", "f over regions": "C2", "vanishing": "black"}
    for name, colour in list(colours.items())[:4]:
        density = data.density.sel(importance=name).mean("block").to_numpy()
        left.plot(x, density, color=colour, label=name, linewidth=0.9)
    left.set(xlabel="x", ylabel="sample density", xlim=(0, 1), ylim=(0, 6.4), title="where the samples go")
    left.legend(ncols=2, fontsize=5.5, loc="upper left")
    for shift, (name, colour) in enumerate(colours.items()):
        image = data.image.sel(importance=name)
        ratio = 100 * (image.mean("block").to_numpy() / exact - 1)
        spread = 100 * image.std("block", ddof=1).to_numpy() / blocks**0.5 / exact
        if name != "constant":
            offset = (shift - 2) * 0.004
            middle.errorbar(
                x + offset, ratio, 3 * spread, fmt=".", markersize=2, linewidth=0.5, color=colour, label=name
            )
        if name != "vanishing":
            right.plot(x, spread * blocks**0.5, color=colour, linewidth=0.9, label=name)
    middle.axhline(0, color="0.5", linewidth=0.5)
    middle.set_yscale("symlog", linthresh=5)
    middle.set_yticks([-100, -10, -5, 0, 5], ["-100", "-10", "-5", "0", "5"])
    middle.minorticks_off()
    middle.set(xlabel="x", ylabel="image / exact - 1 (%)", xlim=(0, 1), ylim=(-200, 8), title="bias; bars: 3 s.e.")
    middle.axhspan(-5, 5, color="0.95", zorder=0)
    middle.text(0.98, -4.7, "linear in the grey band, logarithmic below", ha="right", va="bottom", fontsize=5)
    middle.legend(fontsize=5.5, loc="lower left", bbox_to_anchor=(0, 0.05))
    right.set(xlabel="x", ylabel="s.d. of a block (%)", xlim=(0, 1), title="error of each pixel")
    right.set_ylim(0, 1.35 * right.get_ylim()[1])
    right.legend(fontsize=5.5, loc="upper center", ncols=2)
    return figure


def _bias(data: xr.Dataset, name: str) -> np.ndarray:
    """Each pixel's bias in standard errors."""
    image = data.image.sel(importance=name)
    error = image.std("block", ddof=1).to_numpy() / data.sizes["block"] ** 0.5
    difference = image.mean("block").to_numpy() - data.exact.to_numpy()
    # A pixel that no block has reached is no right one.
    never = np.where(difference == 0, 0, np.inf)
    return np.divide(difference, error, out=never, where=error > 0)


def table(data: xr.Dataset) -> Table:
    """By importance function: acceptance, the largest bias, the spread of the density."""
    result = Table("importance", "acceptance", "largest bias (s.e.)", "density variance", "MSE of a block", box=SIMPLE)
    result.title = "importance_functions: one image of a line by each"
    for name in data.importance.to_numpy():
        here = data.sel(importance=name)
        statistics = density_statistics(here.density.mean("block").to_numpy())
        mse = float(((here.image - data.exact) ** 2).mean())
        bias = f"{np.abs(_bias(data, name)).max():.1f}"
        result.add_row(
            str(name), f"{float(here.acceptance):.3f}", bias, f"{float(statistics.variance):.3f}", f"{mse:.1e}"
        )
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Unbiased, exactly and in a simulation; the loss; the shader; the constant."""
    enumerated = float(data.enumerated)
    worst = max(np.abs(_bias(data, name)).max() for name in UNBIASED)
    spread = data.image.sel(importance=list(UNBIASED)).std("block", ddof=1) / data.sizes["block"] ** 0.5
    seen = 8 * float((spread / data.exact).max())
    lost = float(data.lost)
    short = (data.exact.mean() - data.image.sel(importance="vanishing").mean("pixel")).to_numpy()
    short_error = sem(short)
    gap = abs(short.mean() - lost) / short_error
    share = float(data.shaded)
    expected = 10 * share / (1 + 9 * share)
    edges = np.linspace(0, 1, data.sizes["pixel"] + 1)
    inside = (edges[:-1] >= SHADED[0] - 1e-9) & (edges[1:] <= SHADED[1] + 1e-9)
    got = data.density.sel(importance="shader").to_numpy()[:, inside].sum(1) / data.sizes["pixel"]
    got_error = sem(got)
    squares = {name: data.image.sel(importance=name).var("block", ddof=1).to_numpy() for name in ("f", "shader")}
    better, worse = ((squares["shader"] / squares["f"])[where].mean() for where in (inside, ~inside))
    constant = float(data.acceptance.sel(importance="constant"))
    poisson = data.stratified.sel(kind="constant, large steps").to_numpy()
    ratio = poisson.mean() * float(data.spp)
    ratio_error = sem(poisson) * float(data.spp)
    mse = data.hidden_error.mean("replica").to_numpy()
    return [
        Claim(
            "imp.unbiased-exact",
            "MLT with f / I deposits is unbiased for any importance I that is positive where f is, composed ones too",
            f"{PAPER}, Alg. 1",
            "holds" if enumerated < 1e-12 else "fails",
            "holds",
            f"largest relative bias of a state {enumerated:.1e}",
            "enumeration on a ring, three importance functions; 1e-12",
        ),
        Claim(
            "imp.unbiased",
            "So is the image of a line, by six importance functions: constant, shader, floor, over regions, chained",
            f"{PAPER}, Alg. 1",
            "holds" if worst < 8 else "fails",
            "holds",
            f"largest of {len(UNBIASED) * data.sizes['pixel']} biases {worst:.1f} standard errors",
            f"8 standard errors (t, {data.sizes['block'] - 1} degrees of freedom: by chance in 1e-6 of the runs), "
            f"{seen:.1%} of a pixel at most",
        ),
        Claim(
            "imp.lost-mass",
            "An importance function that vanishes where f does not loses exactly that mass",
            f"ours; {PAPER}, Alg. 1",
            "holds" if gap < 5 and lost > 0 else "fails",
            "holds",
            f"lost {short.mean():.5f}, exactly {lost:.5f}: {gap:.1f} standard errors apart",
            f"5 standard errors of {short_error:.1e}",
        ),
        Claim(
            "imp.shader",
            "A shader by a predicate moves the samples there, and noise with them to the rest",
            f"{PAPER}, sec. 4.1, fig. 3",
            "holds" if abs(got.mean() - expected) < 5 * got_error and better < 1 < worse else "fails",
            "holds",
            f"share {got.mean():.4f}, exactly {expected:.4f} (by f {share:.4f}); variance there times {better:.2f}, "
            f"elsewhere times {worse:.1f}",
            f"5 standard errors of {got_error:.1e}",
        ),
        Claim(
            "imp.constant-accepts",
            "I = constant, in proportion to the technique's density, accepts every proposal",
            f"{PAPER}, appendix",
            "holds" if constant >= 1 - 1e-6 else "fails",
            "holds",
            f"acceptance {constant:.7f}",
            "1e-6, the rounding of float32",
        ),
        Claim(
            "imp.constant-stratifies",
            "I = constant does not stratify: its samples are no more even over the pixels than independent ones",
            f"{PAPER}, appendix, fig. 8",
            "holds" if ratio + 6 * ratio_error > 1 and mse[1] > mse[2] else "fails",
            "holds",
            f"density variance {ratio:.3f} +- {ratio_error:.3f} of independent ones', with large steps; with hidden "
            f"paths, the MSE is {mse[1] / mse[2]:.1f} times that of I = f, {mse[1] / mse[3]:.1f} times theirs",
            "6 standard errors; by theory it is 1",
        ),
    ]
