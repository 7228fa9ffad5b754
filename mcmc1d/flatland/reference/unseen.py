"""What light may fall between a mesh's nodes: on shadow lines at which its panels are not cut.

A beam of light has shadow lines for edges. Where two or more lie between neighbouring nodes, irradiance is computed in
the middle of each interval between them, and held against the nodes' polynomial: the difference is what they missed.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.sparse import csr_array

from mcmc1d.flatland.reference import shadows
from mcmc1d.flatland.reference.glossy import lobe_norm
from mcmc1d.flatland.reference.mesh import Mesh, legendre
from mcmc1d.flatland.reference.operators import Sources
from mcmc1d.flatland.scene import Material


@dataclass(frozen=True)
class Unseen:
    """Intervals between neighbouring shadow lines that hold no node: arrays of N, in all pieces between them, P."""

    sources: Sources
    """Of one node a piece."""
    pieces: np.ndarray
    """The indices of the N."""
    looked: np.ndarray
    """Whether irradiance is computed in it: in the widest, not in all where they are too many."""
    panel: np.ndarray
    """Of the mesh, in which it lies."""
    share: np.ndarray
    """Of that panel."""
    interpolation: csr_array
    """From values at the mesh's nodes to those in the middle of the intervals that are looked into."""
    send: np.ndarray
    """The radiance, (N, 2), that the wall sends out of an irradiance of 1: Lambert's lobe, the glossy one's peak."""

    @staticmethod
    def of(sources: Sources, lines: shadows.ShadowLines, materials: list[Material]) -> "Unseen | None":
        """Those of a mesh; None where there are none."""
        mesh, lengths = sources.mesh, lines.length
        rows, empty = [], []
        for k, length in enumerate(lengths):
            scatters = sources.lambert[k] > 0 or sources.glossy[k] > 0
            cuts = np.concatenate([[0.0], lines.on(k) if scatters else [], [length]])
            before = np.searchsorted(mesh.places[mesh.segment == k].ravel(), cuts)
            rows.append((np.full(len(cuts) - 1, k), cuts[:-1], cuts[1:]))
            empty.append((np.diff(before) == 0) & scatters)
        segment, low, high = (np.concatenate(column) for column in zip(*rows, strict=True))
        pieces = np.flatnonzero(np.concatenate(empty))
        if not len(pieces):
            return None
        middle, k = ((low + high) / 2)[pieces], segment[pieces]
        limits = mesh.segment + mesh.low / lengths[mesh.segment]
        panel = np.searchsorted(limits, k + middle / lengths[k], "right") - 1
        size = (mesh.high - mesh.low)[panel]
        looked = np.zeros(len(pieces), bool)
        looked[np.argsort((low - high)[pieces], kind="stable")[: shadows.MOST]] = True
        local = np.clip(2 * (middle - mesh.low[panel]) / size - 1, -1, 1)[looked]
        values = legvander(local, mesh.order - 1) @ legendre(mesh.order)[2]
        columns = panel[looked][:, None] * mesh.order + np.arange(mesh.order)
        first = np.arange(len(local) + 1) * mesh.order
        shape = (len(local), mesh.order * len(mesh.low))
        send = [[m.lambert / 2, m.glossy / lobe_norm(m.exponent)] for m in materials]
        # Both lobes' light is held in the one table of Lambert's.
        fine = Sources.of(sources.geometry, Mesh(segment, low, high, 1), materials, None)
        fine = replace(fine, lambert=np.maximum(fine.lambert, fine.glossy), glossy=np.zeros(len(lengths)))
        return Unseen(
            sources=fine,
            pieces=pieces,
            looked=looked,
            panel=panel,
            share=(high - low)[pieces] / size,
            interpolation=csr_array((values.ravel(), columns.ravel(), first), shape),
            send=np.array(send)[k],
        )

    @property
    def at(self) -> tuple[np.ndarray, np.ndarray]:
        """The segments, and the places on them, in which to compute irradiance: the middles of those looked into."""
        mesh, some = self.sources.mesh, self.pieces[self.looked]
        return mesh.segment[some], ((mesh.low + mesh.high) / 2)[some]

    def missed(self, found: np.ndarray, nodes: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
        """The irradiance (N,) that the nodes' polynomial lacks, and that it has too much, at most.

        Twice the difference in the middle: what rises from an edge to the other, straight, is no more anywhere. Where
        nobody looked, it may be all there is, `most`, either way.
        """
        difference = np.zeros(len(self.pieces))
        difference[self.looked] = 2 * (found - self.interpolation @ nodes)
        unknown = np.where(self.looked, 0, most)
        return np.maximum(difference, 0) + unknown, np.maximum(-difference, 0) + unknown

    def on_pieces(self, missed: np.ndarray) -> np.ndarray:
        """What they send out of it, of shape (P,)."""
        sent = np.zeros(len(self.sources.mesh.low))
        sent[self.pieces] = missed * self.send.sum(1)
        return sent

    def on_nodes(self, missed: np.ndarray, coarse: Sources) -> tuple[np.ndarray, np.ndarray | None]:
        """The same, spread evenly over the mesh's panels: at its nodes by Lambert's lobe, and in the glossy tables."""
        mesh = coarse.mesh
        lambert, glossy = (np.bincount(self.panel, missed * self.share * x, len(mesh.low)) for x in self.send.T)
        table = None
        if coarse.directions is not None:
            table = np.repeat(glossy[coarse.first_glossy >= 0], mesh.order * coarse.directions.count)
        return np.repeat(lambert, mesh.order), table


__all__ = ["Unseen"]
