"""Forces from bicubic patches of a table, against NumPy's polynomials."""

import numpy as np
import pytest
from numba import njit
from numpy.polynomial.polynomial import polyval2d

from streamkit.engine import FACTOR, Motion, Patches, build_field, linear
from streamkit.engine.patches import BLOCK

COUNT, CELLS = 3, 5
COEFFICIENTS = np.random.default_rng(3).standard_normal((CELLS, 4, COUNT, 4))


@njit
def locate(x, y, z, table):
    """The cell is the whole part of x, f the rest of it, g is y."""
    cell = np.floor(x)
    return cell * 16.0 * COUNT, x - cell, y, z, 0.0, 0.0, 0.0


@njit
def finish(x, y, z, located, values, table):
    """The sum of the patches, weighted by their numbers; the derivative of the first in f; that of the last in g."""
    g, sums = located[2], 0.0
    for k in range(COUNT):
        sums += (k + 1.0) * (values[8 * k] + g * (values[8 * k + 1] + g * (values[8 * k + 2] + g * values[8 * k + 3])))
    along = values[4] + g * (values[5] + g * (values[6] + g * values[7]))
    return sums, along, located[3] * (values[17] + g * (2.0 * values[18] + 3.0 * g * values[19]))


class Read:
    """What the engine needs of a force."""

    kind, compiled = "read", True
    patches = Patches(COUNT, locate, finish)

    def __init__(self, growth=None):
        self.growth = growth

    def in_engine_units(self):
        return (COEFFICIENTS.ravel(),)

    def rotation(self):
        return None

    def motion(self):
        return Motion()

    def changes(self):
        return () if self.growth is None else ((FACTOR, linear(*self.growth)),)

    def in_loop(self):
        return self

    def has_drag(self):
        return False


def expected(x, y, z):
    result = np.empty((3, len(x)))
    for i, (cell, f, g) in enumerate(zip(x.astype(int), x % 1, y, strict=True)):
        patches = COEFFICIENTS[cell].transpose(1, 0, 2)  # (count, 4 powers of f, 4 powers of g)
        in_f = patches[0][1:] * np.arange(1, 4)[:, None]
        in_g = patches[-1][:, 1:] * np.arange(1, 4)
        result[0, i] = sum((k + 1) * polyval2d(f, g, patch) for k, patch in enumerate(patches))
        result[1, i], result[2, i] = polyval2d(f, g, in_f), z[i] * polyval2d(f, g, in_g)
    return result


@pytest.mark.parametrize("n", [1, 3, 4, BLOCK - 1, BLOCK, 2 * BLOCK + 5])
def test_for_every_number_of_particles(n):
    rng = np.random.default_rng(n)
    q = np.stack([rng.uniform(0, CELLS, n), rng.uniform(0, 1, n), rng.standard_normal(n)])
    assert build_field([Read()]).acceleration(0.0, q) == pytest.approx(expected(*q), rel=1e-12, abs=1e-12)


@pytest.mark.slow
def test_beside_another_force_and_with_a_growing_one():
    q = np.array([[0.5, 4.2], [0.1, 0.7], [2.0, -1.0]])
    twice = build_field([Read(), Read((np.array([-2.0, 0.0]), np.array([0.5, 1.0])))])
    assert twice.acceleration(np.array([-1.0, 0.0]), q) == pytest.approx(expected(*q) * [1.75, 2.0], rel=1e-12)
