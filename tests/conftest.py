"""Strict numerics for every test, and a compilation cache that outlives the run."""

import gc
import os
from collections.abc import Sequence
from pathlib import Path

os.environ["MPLBACKEND"] = "Agg"

import jax
import jaxtyping
import numpy.typing
import pytest

_ROOT = Path(__file__).parents[1]

# Tracing makes objects by the million that stay; looking through them for garbage takes 3 % of the time.
gc.set_threshold(100_000)

jax.config.update("jax_compilation_cache_dir", str(_ROOT / ".cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
jax.config.update("jax_numpy_rank_promotion", "raise")

# A tuple of numbers is ArrayLike to a static checker and, for want of one method, not to a run-time one.
numpy.typing.ArrayLike = numpy.typing.ArrayLike | Sequence

# Every shape that the library annotates is checked at run time; the library must not have been imported before. Not
# yet in these modules, whose annotations are narrower than what they take:
#   numerics: "n+1" in an argument can not be checked;  special: `normal_quantile` takes arrays;
#   quadrature: `midpoints` takes scalars;  state: a batch of states is a `State` as well.
_UNCHECKED = {"__init__", "__pycache__", "numerics", "quadrature", "special", "state"}
_MODULES = [f"mcmc1d.{path.stem}" for path in sorted((_ROOT / "mcmc1d").iterdir()) if path.stem not in _UNCHECKED]
jaxtyping.install_import_hook(_MODULES, "strict.check")


_MOST_MAPS = 15_000
"""Compiled code is mapped into memory in pieces, of which Linux grants a process 65,530: at the next it crashes."""


def pytest_runtest_teardown() -> None:
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > _MOST_MAPS:
        jax.clear_caches()


def pytest_configure(config: pytest.Config) -> None:
    # JAX writes its cache in place: a worker that reads what another is writing compiles again, which is no fault.
    config.addinivalue_line("filterwarnings", "ignore:Error (reading|writing) persistent compilation cache")
