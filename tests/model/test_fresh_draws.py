"""Random numbers that differ between parameters: as evenly spread as the common ones, and decided by seed and place."""

import numpy as np
import pytest
from runfiles import APOCENTRES
from scipy.stats import kstest

from streamkit.builtin.stripping.lagrange import LagrangeCloud
from streamkit.model import Model
from streamkit.model.release import shifted_normals, standard_normals


def test_shifted_normals_are_standard_normal_and_more_even_than_independent_ones():
    scheme = LagrangeCloud(particles=2000)
    normals = shifted_normals(standard_normals(scheme, 3), np.random.default_rng(4))
    assert normals.shape == (scheme.draws, 2000)
    for row in normals:
        for tail in (row[::2], row[1::2]):
            assert kstest(tail, "norm").statistic < 0.01  # 0.027 for 1000 independent ones


def test_seed_and_parameters_decide_a_fresh_stream():
    model, again, common = Model(APOCENTRES, fresh=True), Model(APOCENTRES, fresh=True), Model(APOCENTRES)
    first, near = {"potential.v0": 230.0}, {"potential.v0": np.nextafter(230.0, 231.0)}
    np.testing.assert_array_equal(model.stream(first).q, again.stream(first).q)
    fresh = np.abs(model.stream(first).q - model.stream(near).q)
    change = np.abs(common.stream(first).q - common.stream(near).q)
    # A bound particle is chaotic: a last bit of v0 may move it by a kiloparsec.
    assert np.median(fresh) > 1.0 > 1e-3 > np.percentile(change, 90)


@pytest.mark.slow
def test_the_mean_over_fresh_draws_is_that_of_many_particles():
    """The mean position of the debris, from many small streams and from one large one with common random numbers."""
    small = Model(APOCENTRES | {"stripping": APOCENTRES["stripping"] | {"particles": 200}}, fresh=True)
    large = Model(APOCENTRES | {"stripping": APOCENTRES["stripping"] | {"particles": 20000}})
    means = []
    for step in range(40):
        stream = small.stream({"potential.v0": 230.0 + 1e-9 * step})
        means.append(stream.r.mean())
    expected = large.stream({"potential.v0": 230.0}).r.mean()
    assert abs(np.mean(means) - expected) < 4 * np.std(means) / np.sqrt(len(means)) + 0.01 * expected
