"""Cholesky factors of arrow matrices, beside those of whole matrices."""

from itertools import pairwise

import numpy as np
import pytest

from streamkit.builtin.samplers.emulator.walk.arrow import Arrow, solved
from streamkit.builtin.samplers.emulator.walk.density import Layout


@pytest.mark.parametrize(("shared", "sizes"), [(4, (2, 3, 0, 1)), (0, (5,)), (3, (0,)), (2, (40, 1))])
def test_arrows_are_whole_matrices(shared: int, sizes: tuple[int, ...]) -> None:
    rng, ends = np.random.default_rng(1), shared + np.cumsum([0, *sizes])
    layout = Layout(np.arange(shared), [np.arange(a, b) for a, b in pairwise(ends)])
    d, n = ends[-1], 7
    precision = np.zeros((n, d, d)) + np.eye(d)
    for own in layout.own:  # what data of one factor say of its own and the shared coordinates
        columns = np.concatenate([layout.shared, own])
        design = rng.normal(size=(n, 6, len(columns))) * 10.0
        precision[:, columns[:, None], columns] += design.transpose(0, 2, 1) @ design
    arrow, x = Arrow.of(precision, layout), rng.normal(size=(n, d))
    np.testing.assert_allclose(arrow.solve(x), np.linalg.solve(precision, x[:, :, None])[:, :, 0], rtol=1e-8)
    np.testing.assert_allclose(solved(precision, x, layout), arrow.solve(x), rtol=1e-8)
    draws = np.stack([arrow.unwhiten(np.tile(each, (n, 1))) for each in np.eye(d)])
    np.testing.assert_allclose(np.einsum("kni,knj->nij", draws, draws), np.linalg.inv(precision), atol=1e-8)
    np.testing.assert_allclose(2 * arrow.ln_volume(), np.linalg.slogdet(precision)[1])
    np.testing.assert_allclose(np.sum(arrow.whiten_force(x) ** 2, axis=1), np.sum(x * arrow.solve(x), axis=1))


def test_matrices_that_are_not_symmetric_are_solved_as_whole_ones_are() -> None:
    rng = np.random.default_rng(5)
    layout = Layout(np.array([0, 4]), [np.array([1, 2]), np.array([], dtype=int), np.array([3])])
    matrices, right = 4 * np.eye(5) + rng.normal(size=(6, 5, 5)), rng.normal(size=(6, 5))
    matrices[:, [1, 2], 3] = matrices[:, 3, [1, 2]] = 0.0  # own coordinates of two factors
    np.testing.assert_allclose(solved(matrices, right, layout), np.linalg.solve(matrices, right[:, :, None])[:, :, 0])
