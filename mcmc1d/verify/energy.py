"""The logarithm of a law's density at many positions, in the precision that they have."""

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import traced
from mcmc1d.numerics import require
from mcmc1d.verify.law import Law, Position


class Energy:
    """Compiled once: of n positions n numbers. In float32 a float64 position may be rounded onto a wall or a pole."""

    def __init__(self, law: Law):
        density = law.log_density
        assert density is not None
        self.name, self.batch = law.name, jax.jit(jax.vmap(density))

    def __call__(self, where: Position) -> np.ndarray:
        """Raises `ValueError` for a function that is not JAX's, and for one whose value is not one real number."""
        leaves = jax.tree.leaves(where)
        wide = jnp.zeros(()).dtype == np.float64 or any(np.result_type(leaf) == np.float64 for leaf in leaves)
        with jax.enable_x64(wide), traced(f"{self.name}: log_density, a function of one position,"):
            values = np.asarray(self.batch(where))
        require(
            values.shape == leaves[0].shape[:1] and values.dtype.kind in "biuf",
            f"{self.name}: log_density of one position must be one real number, not {values.dtype} of shape "
            f"{values.shape[1:]}: sum over the coordinates",
        )
        return values
