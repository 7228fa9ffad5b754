"""The benchmark's machinery, on made-up speeds; nothing here asserts a real one."""

import os
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from experiments.support import bench, bench_growth, bench_start, bench_steps
from experiments.support.bench_steps import BINS, compiled_yardstick, multiplexed_step


def speeds(**rates):
    """Contestants that are as fast as is said, by round, and the order in which they were asked."""
    asked = []

    def contestant(name, values):
        def go(seed):
            asked.append((name, seed))
            return values[seed - 1]

        return go

    return {name: contestant(name, values) for name, values in rates.items()}, asked


def test_contestants_take_turns():
    contestants, asked = speeds(a=[1, 2, 3], b=[4, 5, 6])
    shown = []
    found = bench.alternate("stage", contestants, 3, lambda *now: shown.append(now))
    assert found == {"a": [1, 2, 3], "b": [4, 5, 6]}
    assert asked == [("a", 1), ("b", 1), ("a", 2), ("b", 2), ("a", 3), ("b", 3)]
    assert shown[-1] == ("stage", 6, 6)


def test_a_slow_spell_of_the_machine_cancels_in_the_ratio():
    """Rounds at a quarter of the speed: the ratio within each is 2, and that of the medians need not be."""
    data = made_up(threefry=[8, 2, 8, 2], hash32=[4, 1, 4, 1])
    assert bench.ratio(data, "step", "threefry", "hash32") == 2


def made_up(**steps):
    steps = steps or {"threefry": [4.0, 5, 6], "hash32": [5.0, 6, 7], "C": [10.0, 10, 10]}
    walks = {"threefry": [4.0, 4, 4], "hash32": [8.0, 8, 8], "emcee stretch": [1.0, 1, 1]}
    rounds = len(next(iter(steps.values())))
    walks = {name: np.resize(values, rounds) for name, values in walks.items()}
    found = {f"ns_{quantity}": (f"size_{quantity}", [2.0, 1.0]) for quantity in bench_growth.SIZES}
    found |= {f"at_{quantity}": (f"size_{quantity}", [1, 10]) for quantity in bench_growth.SIZES}
    return xr.Dataset(
        {
            "step_rate": (("step", "round"), list(steps.values())),
            "walk_rate": (("walk", "round"), list(walks.values())),
            "step_time": ("step", [np.nan] * len(steps)),
            "walk_time": ("walk", [20.0, 20, 60]),
            "two_cores": 1.9,
            "memory_steps": ("memory_steps", [64, 512]),
            "memory_mib": ("memory_steps", [300.0, 301.0]),
            "import_s": 1.0,
            "compile_cold_s": 2.0,
            "compile_cached_s": 0.5,
            **found,
        },
        {"step": list(steps), "walk": list(walks)},
    )


def test_the_ratios_say_what_they_should_and_what_is_missing():
    found = bench.headline(made_up())
    assert found["multiplexed step, threefry / C"] == 0.5
    assert np.isnan(found["multiplexed step, threefry / Numba"])
    assert found["random walk, hash32 / emcee stretch"] == 8
    assert found["  in effective samples a second, hash32 / emcee stretch"] == 24
    assert found["two cores / one"] == 1.9


def test_it_is_drawn_and_tabled():
    data = made_up()
    assert bench.table(data).row_count > 10
    assert len(bench.draw(data).axes) == 9


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system can not pin a process")
def test_pinning_ends_with_the_measurement():
    before = os.sched_getaffinity(0)
    with bench.pinned() as one:
        assert one
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before


@pytest.mark.skipif(compiled_yardstick() is None, reason="no C compiler")
def test_the_yardstick_does_the_work():
    """It prints steps a second, the acceptance, and the distance of its histogram from the target, which is small."""
    printed = subprocess.run([compiled_yardstick(), "48", "2000", "1"], check=True, capture_output=True, text=True)
    rate, acceptance, variation = map(float, printed.stdout.split())
    assert rate > 0
    # 1.5e6 steps at least, of which one in 20 counts: 100 bins scatter by 0.015; no bin's mass is half of another's
    # by accident, and a wrong density, technique or deposit is off by 0.1 and more.
    assert variation < 0.04
    assert 0.72 < acceptance < 0.75
    assert bench_steps._in_numpy(256, 20, 0) > 0  # which raises where it has lost deposits


def test_numpys_step_samples_with_the_techniques_densities():
    """The quantiles of the NumPy contestant are the library's, to the rounding of float32."""
    target, _ = multiplexed_step()
    u = np.linspace(0.01, 0.99, 197, dtype=np.float32)
    for k, technique in enumerate(target.techniques):
        ours = np.array([float(technique.quantile(jnp.asarray(v))) for v in u[::28]])
        np.testing.assert_allclose(bench_steps._sample(u[::28], np.full(len(ours), k)), ours, atol=2e-6)
    assert BINS == 100


def test_sizes_grow_and_memory_is_asked_over_a_long_range():
    assert all(list(sizes) == sorted(sizes) for sizes in bench_growth.SIZES.values())
    assert bench_start.STEPS[-1] >= 100 * bench_start.STEPS[0]
