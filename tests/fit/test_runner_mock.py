"""A whole fit of an N-body stream in a known host, which takes minutes: `pytest -m slow`."""

from pathlib import Path

import numpy as np
import pytest

import streamkit as sk

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_the_host_of_the_mock_is_recovered():
    """The first mock with a fifth of its particles: M and v_c within 3 sigma of its host from 15 to 80 kpc.

    The emulator needs some thousand calls where a chain needs ten times as many. The 68 % interval of M(60 kpc) is
    narrower than 15 %.
    """
    spec = sk.load(EXAMPLES / "mocks" / "mock_tf.toml").with_sampler("emulator")
    few = {"stripping.particles": 2000, "likelihood.noise": "add", "sampler.max_calls": 4000}
    results = sk.run(spec.with_values(few), workers=2, progress=False)
    r = np.array([15.0, 30.0, 45.0, 60.0, 80.0])
    speed = 210 * (144 / (144 + r**2)) ** (0.45 / 4)  # eq. 2 of Gibbons+ 2014, with the example's true host
    for result, true in zip(results.profiles(r), (r * speed**2 / sk.G, speed), strict=True):
        low, median, high = np.percentile(result, [16, 50, 84], axis=0)
        sigma = np.where(true > median, high - median, median - low)
        np.testing.assert_array_less(np.abs(median - true) / sigma, 3)
    mass = np.percentile(results.profiles(r)[0][:, 3], [16, 84])
    assert mass[1] - mass[0] < 0.15 * r[3] * speed[3] ** 2 / sk.G
