"""Mutations of paths: involutions with their log-determinants, and laws that they keep.

Two cases, each of one program, for compiling is nearly all that it costs.

Statistical tests: false-alarm rate 1e-5 each; what each would have caught stands with it.
"""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom, norm

import mcmc1d
from mcmc1d.compiling import quickly
from mcmc1d.flatland import Bidirectional, Light, Material, Paths, Pinhole, Scene, geometry
from mcmc1d.flatland.any_length import AnyLength, LightOfAnyLength
from mcmc1d.flatland.integrators import MLT
from mcmc1d.flatland.integrators.base import brightest
from mcmc1d.flatland.mutants.mutations import TakenForSymmetric
from mcmc1d.flatland.mutations import VEACH, BidirectionalMutation, LensPerturbation, ManifoldStep, Mutations
from mcmc1d.flatland.mutations.base import layout
from mcmc1d.flatland.mutations.bidirectional import deletions
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import polygon
from mcmc1d.metropolis import acceptance
from mcmc1d.moves import Mixture
from mcmc1d.state import State
from mcmc1d.verify.compare import log_abs_det

pytestmark = pytest.mark.slow

N = 1024
STENCIL = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
"""The derivative from six points; its error is of the sixth order in the step."""


def room(direction):
    """A floor that is half a mirror, and a wall that is a lamp: at each bounce a path may go on either way."""
    lamp, wall = Material(emission=1, lambert=0.3), Material(lambert=0.7)
    corners = [(0.0, 0.0), (2.0, 0.0), (2.2, 1.5), (0.0, 1.2)]
    sides = polygon(corners, [Material(lambert=0.3, mirror=0.6), wall, wall, lamp])
    return Scene("room", tuple(sides), Pinhole((0.6, 0.5), direction, 0.7, 4))


def without_mirrors(scene):
    sides = [replace(side, material=replace(side.material, mirror=0)) for side in scene.segments]
    return Scene("plain", tuple(sides), scene.sensor)


def of_length(of, k):
    paths = Paths(of, k)
    return mcmc1d.Multiplexed(Light(paths), Bidirectional(paths), probes=0)


def of_any_length(of, k):
    light = LightOfAnyLength(of, k)
    return mcmc1d.Multiplexed(light, AnyLength(light), probes=0)


ALL = Mixture({"veach": (0.75, VEACH), "manifold": (0.25, ManifoldStep())})
CASES = {
    "all": (ALL, of_length, 3, (1, 0.3)),  # sees the mirror
    "lengths": (BidirectionalMutation(), of_any_length, 2, (-0.3, 1)),  # sees a part of the lamp
}
SEVERAL = pytest.mark.parametrize("name", CASES)


class Outcome(NamedTuple):
    """Proposals from many (index, u, w), and the states that they come from."""

    uw: np.ndarray
    log_det: np.ndarray
    index: np.ndarray
    kind: np.ndarray
    said: Any
    """What the mutation says of the state that it proposes."""
    here: Any
    """What an evaluation finds."""
    acceptance: np.ndarray


@quickly
def proposed(target, move, index, points):
    def one(i, uw):
        state = target.evaluate(State(i, uw[: target.dim_u]))
        there = move.propose(target, state, uw[target.dim_u :])
        flat = jnp.concatenate([there.state.u, there.w])
        index, kind = jnp.asarray(there.state.index, jnp.int32), jnp.asarray(there.kind)
        return Outcome(flat, there.log_det, index, kind, there.state.seen, state.seen, acceptance(state, there))

    return jax.vmap(one)(index, points)


class Case:
    """A mutation and its target, in float64; `wrong`: 1 leaves the proposals' densities out of the acceptance ratio."""

    def __init__(self, name):
        self.move, make, self.edges, direction = CASES[name]
        self.scene = room(direction)
        self.target = make(self.scene, self.edges)
        self.m = self.target.dim_u
        self.d = self.m + self.move.dim_w(self.target)
        self.move.check(self.target)

    def at(self, index, points, wrong=0.0):
        written_out, geometry._WRITTEN_OUT = geometry._WRITTEN_OUT, 0
        try:
            with jax.enable_x64(True):
                move = TakenForSymmetric(self.move, jnp.asarray(wrong))
                parts = [
                    proposed(self.target, move, jnp.asarray(index[k : k + N]), jnp.asarray(points[k : k + N]))
                    for k in range(0, len(index), N)
                ]
        finally:
            geometry._WRITTEN_OUT = written_out
        return jax.tree.map(lambda *each: np.concatenate(each), *parts)

    def points(self, seed, count=N):
        index = np.arange(count, dtype=np.int32) % self.target.n_techniques
        return index, np.random.default_rng(seed).random((count, self.d))

    @property
    def pixels(self):
        return self.scene.sensor.pixels

    def cell(self, x):
        """The pixel at which a path arrives, with its length or, of one length, whether it met a mirror: one number."""
        light = self.target.target
        with jax.enable_x64(True):
            if isinstance(light, Light):
                bounces = np.any(np.asarray(x) >= float(light.paths.walls.total), axis=1)
                return np.asarray(jax.jit(jax.vmap(light.paths.pixel))(jnp.asarray(x))) + self.pixels * bounces
            pixel = jax.jit(jax.vmap(lambda x: light.pixel(x) + self.pixels * (light.edges(x) - 1)))
            return np.asarray(pixel(jnp.asarray(x)))

    def exact(self):
        """The share of each cell in the light, exactly: paths that meet no mirror are those of a scene without."""
        found = image(self.scene, self.edges).values
        if isinstance(self.target.target, Light):
            plain = image(without_mirrors(self.scene), self.edges).values[-1]
            found = np.stack([plain, found[-1] - plain])
        return found.ravel() / found.sum()

    def start(self, seed, count):
        """So many states drawn exactly, by rejection."""
        shortest = self.edges if isinstance(self.target.target, Light) else 1
        most, rng = brightest(self.scene, shortest), np.random.default_rng(seed)
        kept = []
        while sum(len(index) for index, _ in kept) < count:
            index, points = self.points(rng.integers(2**31), 32 * N)
            chosen = np.exp(self.at(index, points).here.log_c) > most * rng.random(len(index))
            kept.append((index[chosen], points[chosen, : self.m]))
        index, u = (np.concatenate(parts)[:count] for parts in zip(*kept, strict=True))
        return index, u


@cache
def case(name):
    return Case(name)


def kinds(it, there, points):
    """The kind of each proposal by name, those that a mixture mixes told apart."""
    if it.move is not ALL:
        return np.array(it.move.kinds)[there.kind]
    inner = np.searchsorted(np.cumsum(VEACH.probabilities)[:-1], points[:, it.m + 1], side="right")
    return np.where(there.kind == 0, np.array(VEACH.kinds)[inner], "manifold")


def log_det_by_stencil(at, index, points, step):
    """Log of |d(u', w') / d(u, w)| from the proposals of neighbours; very low where a neighbour has none."""
    jacobian = np.zeros((len(points), points.shape[1], points.shape[1]))
    for column in range(points.shape[1]):
        for away, weight in STENCIL.items():
            for sign in (1, -1):
                moved = points.copy()
                moved[:, column] += sign * away * step
                jacobian[:, :, column] += sign * weight / step * np.nan_to_num(at(index, moved).uw)
    return np.maximum(log_abs_det(jacobian), -1e3)


@SEVERAL
def test_a_mutation_is_an_involution_with_its_log_determinant(name):
    """At random states of every technique, lit and dark, mirrors' bounces among their vertices.

    The log-determinant against differences of the proposals, to 1e-6 where two steps of them agree that well. What a
    mutation says of its proposal is what an evaluation finds there, and each kind moves lit paths to other lit ones.
    """
    it = case(name)
    index, points = it.points(0)
    there = it.at(index, points)
    possible = np.isfinite(there.log_det) & ((there.uw >= 0) & (there.uw < 1)).all(1)
    back = it.at(there.index, np.where(possible[:, None], there.uw, 0.5))
    assert np.array_equal(back.index[possible], index[possible])
    assert np.abs(back.uw - points)[possible].max() < 1e-9
    assert np.abs(back.log_det + there.log_det)[possible].max() < 1e-7
    coarse, fine = (log_det_by_stencil(it.at, index, points, step) for step in (1e-4, 5e-5))
    smooth = possible & (np.abs(coarse - fine) < 1e-6)
    assert smooth.sum() > 0.95 * possible.sum()
    assert np.abs(fine - there.log_det)[smooth].max() < 1e-6

    lit = possible & np.isfinite(there.said.log_c)
    assert np.array_equal(np.isfinite(back.here.log_c)[possible], lit[possible])
    for found, said in zip(jax.tree.leaves(back.here), jax.tree.leaves(there.said), strict=True):
        np.testing.assert_allclose(found[lit], said[lit], rtol=1e-8, atol=1e-8)
    moved = lit & np.isfinite(there.here.log_c) & (np.abs(there.said.x - there.here.x).max(1) > 0)
    assert set(kinds(it, there, points)[moved]) == {*(("manifold", *VEACH.kinds) if name == "all" else it.move.kinds)}
    # The densities left out, it is wrong where the mutation is not symmetric: it does change a path, and its length.
    if name == "lengths":
        changed = moved & (np.sign(there.said.x) != np.sign(there.here.x)).any(1)
    else:
        changed = moved & (kinds(it, there, points) != "manifold")
    assert np.sum(smooth & changed) > 20
    wrong = np.abs(fine - it.at(index, points, wrong=1.0).log_det)
    assert np.mean(wrong[smooth & changed] > 1e-3) > 0.9


def test_a_mutation_keeps_what_it_says_it_keeps():
    """Of paths without bounces a perturbation moves the first vertex, the others stay; with them it keeps each.

    The bidirectional mutation keeps a vertices from the sensor and b from the lamp.
    """
    it = case("all")
    index, points = it.points(1, 4 * N)
    there = it.at(index, points)
    moved = np.isfinite(there.log_det) & np.isfinite(there.here.log_c) & np.isfinite(there.said.log_c)
    x, y, kind = there.here.x, there.said.x, kinds(it, there, points)
    total = float(it.target.target.paths.walls.total)
    assert np.array_equal(
        (x >= total)[moved & (kind != "bidirectional")], (y >= total)[moved & (kind != "bidirectional")]
    )
    for of in ("lens", "caustic", "multi_chain", "manifold"):
        assert np.sum(moved & (kind == of) & (x >= total).any(1)) > 5, of
    plain = moved & (x < total).all(1) & (y < total).all(1)
    perturbed = plain & (kind != "bidirectional") & (kind != "manifold")
    assert perturbed.sum() > 100
    assert np.abs(x - y)[perturbed, 1:].max() < 1e-9
    assert np.all(np.sum(x != y, axis=1)[plain & (kind == "manifold")] == 1)
    kept = deletions(layout(it.target))
    chosen = (points[:, it.m + 2] * len(kept)).astype(int)
    for n, (a, b) in enumerate(kept):
        rows = plain & (kind == "bidirectional") & (chosen == n)
        stays = np.abs(x - y)[rows][:, [*range(a - 1), *range(it.edges - b, it.edges)]]
        assert rows.sum() > 5
        assert stays.max(initial=0) < 1e-9


@SEVERAL
def test_a_mutation_keeps_the_law_of_the_exact_image(name):
    """Chains start exactly; after some steps the counts by pixel, and length or mirror, are binomials of exact shares.

    Would have caught a share of all light that is 0.03 off with probability 0.99; and catches the mutation without its
    proposals' densities. (With the log-determinant left out it is hardly off: under the balance heuristic that is the
    logarithm of a ratio of two weighted sums of the same densities, a few tenths.)
    """
    it, chains, steps = case(name), 2**14, 6
    exact = it.exact()
    threshold = 1e-5 / 2 / len(exact)
    assert (norm.isf(threshold) + 2.33) * np.sqrt(0.25 / chains) < 0.03
    start = it.start(3, chains)

    def smallest_p(wrong):
        rng, (index, u) = np.random.default_rng(2), start
        for _ in range(steps):
            there = it.at(index, np.hstack([u, rng.random((chains, it.d - it.m))]), wrong)
            accepted = rng.random(chains) < there.acceptance
            index = np.where(accepted, there.index, index)
            u = np.where(accepted[:, None], there.uw[:, : it.m], u)
            assert 0.1 < accepted.mean() < 1
        final = it.at(index, np.hstack([u, rng.random((chains, it.d - it.m))]))
        counts = np.bincount(it.cell(final.here.x), minlength=len(exact))
        p = np.minimum(binom.cdf(counts, chains, exact), binom.sf(counts - 1, chains, exact))
        return p[exact > 1e-9].min()

    assert np.sum(exact > 0.05) >= 4
    assert smallest_p(0.0) > threshold
    assert smallest_p(1.0) < threshold


def test_mutations_refuse_what_they_can_not_change():
    paths = Paths(room((1, 0.3)), 2)
    part = mcmc1d.Multiplexed(Light(paths), Bidirectional(paths, (2, 3)), probes=0)
    with pytest.raises(ValueError, match="every technique, t = 1 to 3, not"):
        LensPerturbation().check(part)
    with pytest.raises(ValueError, match="Bidirectional or AnyLength, not Several"):
        ManifoldStep().check(mcmc1d.Multiplexed(mcmc1d.targets.Sinusoid(), mcmc1d.techniques.Uniform()))
    with pytest.raises(ValueError, match="sum to one"):
        Mutations({"lens": (0.5, LensPerturbation())})
    with pytest.raises(ValueError, match="without bidirectional"):
        MLT(bidirectional=0.0, lens=0.65)
