"""Mistakes in what f or a density is a product of: 3D's factors, wrong measures, delta lights; and wrong scales."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require_instance
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.geometry import Vector
from mcmc1d.flatland.integrators import MMLT, PSSMLT, BidirectionalPathTracing, LightTracing
from mcmc1d.flatland.integrators.base import Integrator, brightest
from mcmc1d.flatland.integrators.image import Layer
from mcmc1d.flatland.integrators.independent import independent
from mcmc1d.flatland.mutants import Mutant, two_lamps
from mcmc1d.flatland.mutants.altered import Altered
from mcmc1d.flatland.paths import Paths, lamps
from mcmc1d.flatland.sampling import bootstrap
from mcmc1d.flatland.scene import Scene
from mcmc1d.numerics import pick
from mcmc1d.state import Multiplexed
from mcmc1d.techniques import Looked
from mcmc1d.types import Array, Float, Index, Key


class Powers(eqx.Module):
    """What f or a density is multiplied by, in excess of the truth: powers, all 0 where nothing is wrong."""

    distance: np.ndarray
    """f: of each edge's length."""
    bounces: np.ndarray
    """f: of 2 / pi, for each vertex at which it is scattered."""
    camera: np.ndarray
    """f: of the cosine at the pinhole."""
    measure: np.ndarray
    """The density of the path that hits a lamp: of what makes a density of directions one of places there."""
    lamps: np.ndarray
    """The densities of paths that begin on a lamp: of the probability that it was chosen."""
    mirrors: np.ndarray
    """1: a technique that would join at a mirror stands in the weights' denominator."""

    def __init__(self, **wrong: float):
        """`wrong`: those that are not 0."""
        for name in ("distance", "bounces", "camera", "measure", "lamps", "mirrors"):
            setattr(self, name, np.asarray(wrong.get(name, 0.0)))


class Tampered(Altered):
    """The techniques of bidirectional path tracing, with light and densities that are off."""

    powers: Powers

    def look(self, target: Any, index: Index, u: Float[Array, " m"]) -> Looked:
        x, v, log_det, log_f, log_p, *_ = self.right.look(target, index, u)
        paths, wrong, k = self.right.paths, self.powers, self.right.paths.edges
        walls = paths.walls
        points = paths.vertices(x)
        steps = [Vector(points[j + 1, 0] - points[j, 0], points[j + 1, 1] - points[j, 1]) for j in range(k)]
        log_far = [jnp.log(jnp.maximum(step.length(), 1e-6)) for step in steps]
        segment, _ = walls.place(jnp.minimum(x[-1], walls.total * (1 - 1e-6)))
        log_f = log_f + wrong.distance * sum(log_far) + wrong.bounces * (k - 1) * np.log(2 / np.pi)
        sensor: Any = paths.sensor
        forward = steps[0].dot(Vector(sensor.ahead[0], sensor.ahead[1])) / jnp.exp(log_far[0])
        log_f = log_f + wrong.camera * jnp.log(jnp.maximum(forward, 1e-6))
        cosine = jnp.abs(steps[-1].dot(walls.frame(segment).normal)) / jnp.exp(log_far[-1])
        to_places = jnp.log(jnp.maximum(cosine, 1e-6)) - log_far[-1]
        chosen = jnp.log(walls.at(walls.length, segment) / lamps(walls)[-1])
        own, found = pick(log_p, index), []
        for t, p in zip(self.right.lengths, log_p, strict=True):
            tampered = p + (wrong.measure * to_places if t == k + 1 else wrong.lamps * chosen)
            found.append(jnp.where(jnp.isneginf(tampered) & (wrong.mirrors > 0), own, tampered))
        return Looked(x, v, log_det, log_f, tuple(found))


class Wrong(Integrator):
    """Bidirectional path tracing with tampered factors."""

    powers: Powers

    def target(self, paths: Paths) -> Multiplexed:
        right = BidirectionalPathTracing().target(paths)
        assert isinstance(right.family, Bidirectional)
        return Multiplexed(right.target, Tampered(right.family, self.powers), right.weights, probes=0)

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        return independent(key, self, scene, edges, samples, brightest(scene, edges))


class Rescaled(Integrator):
    """An integrator whose image is multiplied by a number that is not one."""

    right: Integrator
    factor: Callable[[Integrator, Scene, Layer], float] = eqx.field(static=True)

    def target(self, paths: Paths) -> Multiplexed:
        return self.right.target(paths)

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        layer = require_instance(self.right.render(key, scene, edges, samples), Layer, "Rescaled: the right layer")
        return layer.scaled(self.factor(self.right, scene, layer))


def _one_technique(right: Integrator, scene: Scene, layer: Layer) -> float:
    return 1 / right.target(Paths(scene, layer.edges)).n_techniques


def _to_b(right: Integrator, scene: Scene, layer: Layer) -> float:
    """To the mean of a right image: b by itself says nothing of where the light is."""
    target = BidirectionalPathTracing().target(Paths(scene, layer.edges))
    b = bootstrap(_key(), target, 2**18, 1.0).mean.item()
    return float(b / layer.value.mean())


def _b_of_the_sum(right: Integrator, scene: Scene, layer: Layer) -> float:
    target = BidirectionalPathTracing().target(Paths(scene, layer.edges))
    assert layer.normaliser is not None
    return bootstrap(_key(), target, 2**18, 1.0).mean.item() / layer.normaliser.mean.item()


def _per_pixel(right: Integrator, scene: Scene, layer: Layer) -> float:
    return 1 / scene.sensor.pixels


def _key() -> Key:
    return jax.random.key(101)


def _tampered(mistake: str, origin: str, **wrong: float) -> Mutant:
    return Mutant(Wrong(Powers(**wrong)), Wrong(Powers()), mistake, origin, scene=two_lamps())


MUTANTS = {
    "r_squared": _tampered(
        "G = V cos cos / r^2, as in space", "the geometry term of Veach 1997, chapter 8", distance=-1.0
    ),
    "lambert_over_pi": _tampered("f_r = rho / pi, as in space", "Lambert's BRDF in space", bounces=1.0),
    "camera_cubed": _tampered(
        "importance 1 / (A cos^3) where 1 / (A cos^2) is meant",
        "the cosines of a perspective camera in space: pbrt-v3's has 1 / (A cos^4)",
        camera=-1.0,
    ),
    "camera_cosine": _tampered(
        "the full G at a pinhole with p(phi) for the importance",
        "a slip that costs 6 % in a scene of one lamp",
        camera=1.0,
    ),
    "wrong_measure": _tampered(
        "a hit lamp's density left in d theta, not converted to d length",
        "what pbrt-v3's ConvertDensity is for",
        measure=-1.0,
    ),
    "lamp_unchosen": _tampered(
        "the density of a point on a lamp without the probability of the lamp",
        "what pbrt-v3's PdfLightOrigin is for",
        lamps=-1.0,
    ),
    "mirror_in_denominator": _tampered(
        "a technique that would join at a mirror counts in the weights",
        "what pbrt-v3's MISWeight remaps densities of zero for",
        mirrors=1.0,
    ),
    "techniques_missing": Mutant(
        Rescaled(MMLT(chains=2048), _one_technique),
        MMLT(chains=2048),
        "contributions not multiplied by the number of techniques",
        "Hachisuka et al. 2014, section 4: the factor k + 2; pbrt-v3's nStrategies",
    ),
    "rescaled_to_b": Mutant(
        Rescaled(Wrong(Powers(distance=-1.0)), _to_b),
        Wrong(Powers()),
        "a wrong G, hidden by rescaling the image to b",
        "images compared after tone mapping or normalisation",
        scene=two_lamps(),
        samples=2**19,
    ),
    "maximum_by_b_of_sum": Mutant(
        Rescaled(PSSMLT(combine="maximum", chains=2**13), _b_of_the_sum),
        PSSMLT(combine="maximum", chains=2**13),
        "the maximum's chain normalised by the integral of the sum",
        "Hachisuka et al. 2014, Alg. 1, with another scalar contribution than b's",
        samples=2**19,
    ),
    "splat_scale": Mutant(
        Rescaled(LightTracing(), _per_pixel),
        LightTracing(),
        "splats divided by the number of pixels once more",
        "the splatScale of pbrt-v3's Film::WriteImage",
    ),
}
