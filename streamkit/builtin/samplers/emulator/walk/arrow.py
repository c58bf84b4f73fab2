"""Matrices in the form of an arrow: the own coordinates of a factor are tied to the shared ones alone.

Their Cholesky factor has the same form if the shared coordinates come last. Its cost grows with the number of factors,
where that of a whole matrix grows with its cube.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.walk.density import Layout


class Block(NamedTuple):
    """The part of one factor.

    Attributes
    ----------
    own
        (k,) indices of its coordinates.
    root, inverse
        (n, k, k) lower Cholesky factor L of its precision, and the inverse of L.
    across
        (n, h, k) what ties the shared coordinates to it, times the inverse of L'.
    """

    own: IntArray
    root: Array
    inverse: Array
    across: Array


class Arrow(NamedTuple):
    """Cholesky factors of n precision matrices (n, d, d).

    Attributes
    ----------
    shared
        (h,) indices of the shared coordinates.
    blocks
        Those of the factors with coordinates of their own.
    root, inverse
        (n, h, h) lower factor of what the blocks leave of the shared coordinates' precision, and its inverse.
    """

    shared: IntArray
    blocks: tuple[Block, ...]
    root: Array
    inverse: Array

    @classmethod
    def of(cls, precision: Array, layout: Layout) -> Arrow:
        """Factorise matrices (n, d, d). Raises LinAlgError where one is not positive definite."""
        shared, blocks = layout.shared, []
        left = _part(precision, shared, shared)
        for own in layout.own:
            if not len(own):
                continue
            root, inverse = _factor(_part(precision, own, own))
            across = _part(precision, shared, own) @ _turned(inverse)
            left = left - across @ _turned(across)
            blocks.append(Block(own, root, inverse, across))
        return cls(shared, tuple(blocks), *_factor(left))

    def unwhiten(self, white: Array) -> Array:
        """(n, d) Return x with x' P x = |white|^2, for white (n, d): of normal numbers, draws of covariance 1 / P."""
        x, h = np.empty_like(white), times(_turned(self.inverse), white[:, self.shared])
        for own, _, inverse, across in self.blocks:
            x[:, own] = times(_turned(inverse), white[:, own] - times(_turned(across), h))
        x[:, self.shared] = h
        return x

    def whiten_force(self, force: Array) -> Array:
        """(n, d) Return white with |white|^2 = force' P^-1 force, for force (n, d)."""
        white, left = np.empty_like(force), force[:, self.shared]
        for own, _, inverse, across in self.blocks:
            white[:, own] = times(inverse, force[:, own])
            left = left - times(across, white[:, own])
        white[:, self.shared] = times(self.inverse, left)
        return white

    def solve(self, force: Array) -> Array:
        """(n, d) Return x with P x = force (n, d)."""
        return self.unwhiten(self.whiten_force(force))

    def ln_volume(self) -> Array:
        """(n,) Return half of ln of the determinants."""
        roots = (self.root, *(block.root for block in self.blocks))
        return np.asarray(sum(np.log(np.einsum("nii->ni", root)).sum(axis=1) for root in roots))


def solved(matrices: Array, right: Array, layout: Layout) -> Array:
    """(n, d) Return x with M x = right (n, d), for matrices M (n, d, d) of this form, which need not be symmetric.

    Raises LinAlgError where one is singular.
    """
    shared, x = layout.shared, np.empty_like(right)
    left, rest = _part(matrices, shared, shared), right[:, shared, None]
    found: list[Array] = []
    for own in layout.own:
        both = np.concatenate([_part(matrices, own, shared), right[:, own, None]], axis=2)
        both = np.linalg.solve(_part(matrices, own, own), both)
        across = np.matmul(_part(matrices, shared, own), both)
        left, rest = left - across[:, :, :-1], rest - across[:, :, -1:]
        found.append(both)
    x[:, shared] = h = np.asarray(np.linalg.solve(left, rest)[:, :, 0], dtype=float)
    for own, both in zip(layout.own, found, strict=True):
        x[:, own] = both[:, :, -1] - times(both[:, :, :-1], h)
    return x


def _part(matrices: Array, rows: IntArray, columns: IntArray) -> Array:
    return np.asarray(matrices[:, rows[:, None], columns])


def _factor(matrices: Array) -> tuple[Array, Array]:
    """Return lower Cholesky factors of matrices (n, k, k), and their inverses."""
    root = np.linalg.cholesky(matrices).astype(float)
    return root, np.linalg.inv(root).astype(float)


def _turned(matrices: Array) -> Array:
    return matrices.transpose(0, 2, 1)


def times(matrices: Array, vectors: Array) -> Array:
    """(n, i) Products of matrices (n, i, j) and vectors (n, j)."""
    return np.asarray(np.matmul(matrices, vectors[:, :, None])[:, :, 0])
