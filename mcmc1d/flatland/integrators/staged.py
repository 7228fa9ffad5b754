"""Metropolis in stages, each with an importance function made of the image so far (Hoberock and Hart 2010)."""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np

from mcmc1d.checks import require, require_positive, require_whole
from mcmc1d.flatland.importance import OverPixels, Shader
from mcmc1d.flatland.integrators.base import Integrator, brightest
from mcmc1d.flatland.integrators.exposure import exact_starts, expose, highest_seen, unexposed
from mcmc1d.flatland.integrators.image import Layer, Stacked
from mcmc1d.flatland.integrators.independent import BidirectionalPathTracing, PathTracing
from mcmc1d.flatland.paths import Light, Paths
from mcmc1d.flatland.sampling import Sums, bootstrap
from mcmc1d.flatland.scene import Scene
from mcmc1d.image import Film
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import LargeStep, Mixture, SmallStep, StepAndChange
from mcmc1d.perception import EXPOSURE
from mcmc1d.pixels import Pixels, resample
from mcmc1d.stages import MultiStage, NoiseAware, Stage, plan
from mcmc1d.starts import MOST_CANDIDATES
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Key

SCHEMES = ("one_stage", "two_stage", "multi_stage", "noise_aware")


class Staged(NamedTuple):
    """What one stage made, of every replica."""

    samples: int
    """Of each replica."""
    kept: bool
    """Whether it is part of the image."""
    values: np.ndarray
    """The importance function, by what f is multiplied in each pixel: (replicas, pixels)."""
    b: np.ndarray
    """Its integral, exact or estimated: (replicas,)."""
    normaliser: Sums | None
    """What b was estimated from; None where it is known."""
    start: State | None
    """The exact starts of the chains, (replicas chains); None where no light was found, and none were run."""
    deposits: np.ndarray
    """What each chain put into each pixel per step, 1 / I in units of f left out: (replicas, chains, pixels)."""
    acceptance: np.ndarray
    """(replicas,)."""
    film: Film
    """The stage's own, in absolute scale: (replicas, pixels)."""


class StagedMLT(Integrator):
    """MMLT that samples I = f times a number for each pixel, in stages, and deposits f / I.

    - `"one_stage"`: I = f, ordinary MLT, but for a shader;
    - `"two_stage"`: a test image by I = f, thrown away; then f over it at `test_regions` of the resolution (section
      4.2, after Veach 1997, section 11.5; how much goes to the test image is open in the paper);
    - `"multi_stage"`: Algorithm 2, as `stages.plan` has it, every stage kept, with the weight of its samples;
    - `"noise_aware"`: the same, times the visible noise of the image so far (section 4.3; `perception.noise_target`).

    A region of the image that is not made of whole pixels gives each its share by overlap. Each stage's chains start
    exactly, and b is estimated by independent samples of that stage's I alone: so each stage's image is unbiased given
    those before it. The image of one path length leads the chain of that length. `samples` are mutations of all
    stages; each stage makes one for each chain at least.
    """

    scheme: Literal["one_stage", "two_stage", "multi_stage", "noise_aware"] = eqx.field(
        static=True, default="multi_stage"
    )
    shader: Shader | None = None
    of: BidirectionalPathTracing | PathTracing = BidirectionalPathTracing()
    """Whose techniques and weights make the paths."""
    sigma: float = 0.05
    large: float = 0.1
    linear: int = eqx.field(static=True, default=10)
    """Stages from half of the resolution to all of it."""
    floor: float = eqx.field(static=True, default=0.01)
    """What a region of the image counts at least, as a share of the mean; see `MultiStage`."""
    luminance: float = eqx.field(static=True, default=EXPOSURE)
    """Of the image's mean in cd/m^2, for the eye's threshold."""
    test_share: float = eqx.field(static=True, default=1 / 16)
    """Of the samples, for the test image of two-stage."""
    test_regions: float = eqx.field(static=True, default=1 / 4)
    """Its resolution, as a share of the pixels."""
    chains: int = eqx.field(static=True, default=1024)
    candidates: int = eqx.field(static=True, default=MOST_CANDIDATES)
    """For the exact starts of a stage; should they take more, it is a `StartError`."""
    spent_on_b: float = eqx.field(static=True, default=0.25)
    """Samples for b, as a share of a stage's mutations."""

    def __check_init__(self):
        require(self.scheme in SCHEMES, f"StagedMLT: scheme must be one of {', '.join(SCHEMES)}, not {self.scheme!r}")
        require_whole(self.chains, "StagedMLT: chains, for a standard error,", 2)
        require_whole(self.linear, "StagedMLT: linear")
        require_whole(self.candidates, "StagedMLT: candidates")
        require_positive(self, floor=self.floor, luminance=self.luminance, spent_on_b=self.spent_on_b)
        shares = self.test_share, self.test_regions
        require(
            0 < shares[0] < 1 and 0 < shares[1] <= 1,
            f"StagedMLT: test_share and test_regions are shares, not {shares[0]} and {shares[1]}",
        )

    def target(self, paths: Paths) -> Multiplexed:
        """That of the first stage."""
        plain = self.of.target(paths)
        importance = OverPixels(Light(paths), np.ones(paths.sensor.pixels), self.shader)
        return Multiplexed(importance, plain.family, plain.weights, probes=0)

    def kernel(self) -> Metropolis:
        """What steps the chains, in every stage."""
        steps = {"large": (self.large, StepAndChange(LargeStep())), "small": (1 - self.large, SmallStep(self.sigma))}
        return Metropolis(Mixture(steps))

    def stages(self, pixels: int, samples: int) -> list[tuple[Stage, bool]]:
        """The stages of an image of so many pixels, and whether each is kept."""
        if self.scheme == "one_stage":
            return [(Stage(1, samples), True)]
        if self.scheme == "two_stage":
            first = max(1, round(self.test_share * samples))
            regions = max(1, round(self.test_regions * pixels))
            return [(Stage(1, first), False), (Stage(regions, samples - first), True)]
        return [(stage, True) for stage in plan(pixels, samples, linear=self.linear)]

    def values(self, film: Film | None, stage: Stage, pixels: int) -> np.ndarray:
        """By what f is multiplied in each pixel, (replicas, pixels), given the film so far; 1 while there is none."""
        if film is None:
            return np.ones((1, pixels))
        adapt = MultiStage(Pixels(pixels), self.floor)
        if self.scheme != "noise_aware":
            return resample(adapt(film, stage.regions), pixels, 1)
        mean = film.image().mean(-1)
        bright = film.scaled(1 / np.where(mean > 0, mean, 1))
        return resample(NoiseAware(adapt, self.luminance)(bright, stage.regions), pixels, 1)

    def staged(
        self,
        key: Key,
        scene: Scene,
        edges: int,
        samples: int,
        *,
        replicas: int = 1,
        exact: np.ndarray | None = None,
    ) -> Iterator[Staged]:
        """The stages of independent images, one a replica, each adapted to itself by `chains` chains.

        `samples`: of each replica; `exact`: the exact image, (pixels,), by which every b is known. Without it b is
        estimated, for one replica.
        """
        require(exact is None or self.shader is None, "StagedMLT: the exact image tells b of no shader")
        require(exact is not None or replicas == 1, "StagedMLT: b is estimated for one replica; give the exact image")
        paths, film = Paths(scene, edges), None
        target, pixels = self.target(paths), scene.sensor.pixels
        most = target.n_techniques * brightest(scene, edges)
        most *= 1.0 if self.shader is None else max(1.0, float(self.shader.factor))
        first_key, key = jax.random.split(key)
        highest = highest_seen(first_key, target)
        for s, (stage, kept) in enumerate(self.stages(pixels, samples)):
            b_key, start_key, step_key = jax.random.split(jax.random.fold_in(key, s), 3)
            values = np.broadcast_to(self.values(film, stage, pixels), (replicas, pixels))
            own = eqx.tree_at(lambda t: t.target.values, target, values[0])
            normaliser = None
            if exact is None:
                normaliser = bootstrap(b_key, own, int(self.spent_on_b * stage.samples), most * float(values.max()))
            b = (values * exact).mean(1) if normaliser is None else normaliser.mean
            steps, start = max(1, round(stage.samples / self.chains)), None
            if b.all():
                start = exact_starts(start_key, target, values, self.chains, highest, self.candidates)
                found = expose(step_key, self.kernel(), target, values, start, steps)
            else:  # no sample for b brought light: its product with what chains would deposit is zero
                found = unexposed(replicas, self.chains, pixels)
            new = self._film(found.rows.sum(1), values, b, steps * self.chains, target.n_techniques)
            film = new if film is None else film.plus(new)
            deposits, rate = found.rows[:, :, 1] / steps, found.acceptance.mean(1)
            yield Staged(steps * self.chains, kept, values, b, normaliser, start, deposits, rate, new)

    def _film(self, sums: np.ndarray, values: np.ndarray, b: np.ndarray, samples: int, techniques: int) -> Film:
        """Of the sums of `Moments`, (replicas, rows, pixels)."""
        density, value, squares, area, contribution = np.moveaxis(sums, 1, 0)
        rows = density, value / values, techniques * squares / values**2, area / techniques, contribution / values**2
        return Film.of(np.stack(rows, -1), b, samples)

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Stacked:
        pixels, layers, rays = scene.sensor.pixels, [], 0.0
        kept = 0
        for stage in self.staged(key, scene, edges, samples):
            assert stage.normaliser is not None
            rays += float(edges) * (stage.normaliser.size + (0 if stage.start is None else stage.samples))
            if not stage.kept:
                continue
            each = stage.deposits[0]
            most = 1.0 if self.shader is None else max(1.0, 1 / float(self.shader.factor))
            # What f was multiplied by is divided out here: then a chain's deposit is bounded, whatever it was.
            scale = stage.samples * pixels / stage.values[0]
            film, b = Sums(self.chains, each.sum(0), (each**2).sum(0), most), stage.normaliser
            if stage.start is None:  # no chain ran: what is known of the light are the samples for b, all dark
                nothing = np.zeros(pixels)
                film, b = Sums(b.size, nothing, nothing, most * b.bound), None
            layers.append(Layer(edges, scale, film, b, rays))
            kept, rays = kept + stage.samples, 0.0
        return Stacked(tuple(layer.scaled(1 / kept) for layer in layers))


__all__ = ["SCHEMES", "Staged", "StagedMLT"]
