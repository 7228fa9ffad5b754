"""Images are taken anew until they are sharp: when that ends, with stand-ins for the renderer and the comparison."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments import flatland_images
from experiments.support import flatland_sharp
from mcmc1d.flatland.integrators import INTEGRATORS
from mcmc1d.flatland.scenes import scene
from mcmc1d.starts import StartError


@pytest.fixture
def looks(monkeypatch):
    """The samples of each image, whose error is `error(samples)` at `rays(samples)`."""
    taken = []

    def of(error, rays=lambda samples: 3 * samples, work=np.inf, goal=0.01, first=1000):
        taken.clear()

        def integrate(key, make, of, *, lengths, samples):
            taken.append(samples)
            return SimpleNamespace(rays=rays(samples), samples=samples)

        def compare(image, exact, level):
            assert level == pytest.approx(1e-5 / flatland_sharp.LOOKS)
            return SimpleNamespace(detectable=np.array([[error(image.samples)]]))

        monkeypatch.setattr(flatland_sharp, "integrate", integrate)
        monkeypatch.setattr(flatland_sharp, "compare", compare)
        import jax

        room = scene("box")
        flatland_sharp.sharp(jax.random.key(0), INTEGRATORS["mmlt"], room, 2, first, goal, work, (None,), 1e-5)
        return list(taken)

    return of


def test_one_look_is_enough_for_what_is_sharp(looks):
    assert looks(lambda samples: 0.001) == [1000]


@pytest.mark.parametrize("power", [0.5, 0.4])
def test_it_ends_sharp_without_much_more_than_it_takes(looks, power):
    """An error that falls as samples^-power from 3 %, which is to be 1 %."""
    taken = looks(lambda samples: 0.03 * (1000 / samples) ** power)
    needed = 1000 * 3 ** (1 / power)
    assert needed <= taken[-1] <= 2.5 * needed
    assert len(taken) <= flatland_sharp.LOOKS


def test_what_has_no_bound_is_taken_once(looks):
    assert looks(lambda samples: np.inf) == [1000]


def test_all_the_work_there_is_ends_it(looks):
    """Of 3 rays a sample and the box's segments: after it has been had once there is no further look."""
    taken = looks(lambda samples: 1.0, work=5_000_000)
    assert len(taken) == 3
    assert taken[-1] == pytest.approx(5_000_000 / 3 / len(scene("box").segments), rel=1e-3)


def _row(monkeypatch, error):
    def sharp(*_):
        raise error

    monkeypatch.setattr(flatland_images, "sharp", sharp)
    dark = [[0.0] * 4] * 2
    return flatland_images.held("box", "multi_stage", 2, 4, 4, 10, 0.1, 0, 1e-6, dark, dark)


def test_an_image_that_chains_can_not_start_has_no_bound(monkeypatch):
    row = _row(monkeypatch, StartError("a narrow peak"))
    assert np.isposinf(row["detectable"])
    assert row["blind"] == 0


def test_another_error_is_no_dull_image(monkeypatch):
    with pytest.raises(ValueError, match="something else"):
        _row(monkeypatch, ValueError("something else"))


@pytest.mark.parametrize("profile", ["quick", "paper"])
def test_each_profile_asks_for_every_image_of_it(profile):
    """`longer` names no scene in the quick one: an empty list was refused there."""
    asked = {}

    class Progress:
        def map(self, stage, work, points):
            asked[stage] = points
            if stage == "images":
                raise InterruptedError
            return [([0.0], [0.0]) for _ in points]

    config = flatland_images.PROFILES[profile]
    with pytest.raises(InterruptedError):
        flatland_images.run(config, 0, Progress())
    work = {point[0]: point[5] for point in asked["images"]}
    assert work == {s: 30 + 4 * (s in config.longer.split()) for s in config.scenes.split()}
