"""Views inside compiled functions are slices of NumPy, and compilation leaves the collector of garbage as it was."""

import gc

import numpy as np
import pytest
from numba import njit

from streamkit.engine.cache import uncollected
from streamkit.engine.views import axes_view, fill, rest, row_view, view


@njit
def parts(numbers, begin, end):
    x, y, z = axes_view(numbers, begin, end, 8)
    return view(numbers, begin, end).copy(), rest(numbers, begin).copy(), x.copy(), y.copy(), z.copy()


@njit
def part_of_row(table, k, begin, end):
    return row_view(table, k, begin, end).copy()


@njit
def store(numbers, begin, end):
    place = view(numbers, begin, end)
    for i in range(place.shape[0]):
        place[i] = 7
    fill(rest(numbers, 20), 1, 3, -1)


@pytest.mark.parametrize("kind", [float, np.int8])
@pytest.mark.parametrize(("begin", "end"), [(0, 5), (2, 8), (3, 3)])
def test_views_are_slices(kind, begin, end):
    numbers = np.arange(24).astype(kind)
    slices = numbers[begin:end], numbers[begin:], *(numbers[8 * k + begin : 8 * k + end] for k in range(3))
    for found, expected in zip(parts(numbers, begin, end), slices, strict=True):
        assert found.dtype == expected.dtype
        assert np.array_equal(found, expected)
    table = numbers.reshape(3, 8)
    assert np.array_equal(part_of_row(table, 1, begin, end), table[1, begin:end])


def test_what_is_stored_in_a_view_is_stored_in_the_array():
    numbers = np.arange(24)
    store(numbers, 4, 6)
    expected = np.arange(24)
    expected[4:6], expected[21:23] = 7, -1
    assert np.array_equal(numbers, expected)


@pytest.mark.parametrize("enabled", [True, False])
def test_the_collector_is_left_as_it_was(enabled):
    before = gc.isenabled()
    try:
        (gc.enable if enabled else gc.disable)()
        with uncollected():
            assert not gc.isenabled()
        assert gc.isenabled() is enabled
    finally:
        (gc.enable if before else gc.disable)()
