"""What an integrator is: a target and techniques for the paths of each length, and a way to sample them."""

import abc

import equinox as eqx
import numpy as np

from mcmc1d.checks import require
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.integrators.image import Layer, Stacked
from mcmc1d.flatland.paths import Light, Paths
from mcmc1d.flatland.plane import distance
from mcmc1d.flatland.scene import Pinhole, Scene
from mcmc1d.numerics import is_concrete
from mcmc1d.state import Multiplexed
from mcmc1d.types import Key
from mcmc1d.weights import Power, Weights


class Integrator(eqx.Module):
    """Renders the light of one path length at a time, in absolute scale.

    Rays are counted as a renderer traces them: one for each edge that is walked or looked along, so k for a path of k
    edges by whatever technique, none for a reversible jump, which keeps its path, and where one u makes a path by
    every technique, one for each step of both walks and one for each joint. A walk that comes upon a black wall is
    counted to its end. Those for b are counted; chains start exactly, and what that takes, which a renderer spares
    itself by choosing its starts among the samples for b, is not.
    """

    def check(self, scene: Scene, edges: int) -> None:
        """Raise `ValueError` where the integrator can not render the scene's light of that length."""

    @abc.abstractmethod
    def target(self, paths: Paths) -> Multiplexed:
        """What is sampled: paths of one length, seen through techniques."""

    @abc.abstractmethod
    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer | Stacked:
        """The light of `edges` edges by about so many samples: paths, or mutations of chains."""


def multiplexed(paths: Paths, lengths: tuple[int, ...] | None, weights: Weights | None) -> Multiplexed:
    """Light by the techniques of bidirectional path tracing with t in `lengths`: all of them where it is None.

    Raises `ValueError` for a power heuristic of an exponent under 1, with which w f / p has no bound.
    """
    bounded = (
        not isinstance(weights, Power) or not is_concrete(weights.beta) or bool(np.all(np.asarray(weights.beta) >= 1))
    )
    require(bounded, "the power heuristic's beta must be 1 at least here: below, w f / p is unbounded")
    return Multiplexed(Light(paths), Bidirectional(paths, lengths), weights, probes=0)


def brightest(scene: Scene, edges: int) -> float:
    """What f / p of path tracing without next event estimation never exceeds, and so f / (the sum of all p_i).

    The lobes are sampled in proportion to what they send on at most, so a bounce multiplies by the reflectance or less.
    """
    response = 1.0 if isinstance(scene.sensor, Pinhole) else 2.0
    return response * scene.emission * scene.reflectance ** (edges - 1)


def brightest_from_lamps(scene: Scene, edges: int) -> float:
    """The same of light tracing: of paths that hit a wall sensor, or are joined to a pinhole, whose distance counts."""
    emission, lamps, reflectance, sensor = scene.emission, scene.lamp_length, scene.reflectance, scene.sensor
    if not isinstance(sensor, Pinhole):
        k = scene.sensor_segment
        assert k is not None
        return 2 * emission * lamps * reflectance ** (edges - 1) / scene.segments[k].length
    near = min(distance(np.asarray(sensor.position, np.float64), pair) for pair in scene.ends)
    response = 1 / (2 * np.tan(sensor.half_angle) * np.cos(sensor.half_angle) ** 2) / near
    if edges == 1:
        return emission * lamps * response
    # At the joint nothing is sampled: f_r times the cosine is at most a half of Lambert's rho, and rho / I_n of a lobe.
    steepest = max((s.material.exponent for s in scene.segments if s.material.glossy > 0), default=0)
    peak = max(0.5, np.sqrt((steepest + 1) / (2 * np.pi))) if steepest else 0.5
    return 2 * emission * lamps * reflectance ** (edges - 1) * peak * response


__all__ = ["Integrator", "brightest", "brightest_from_lamps", "multiplexed"]
