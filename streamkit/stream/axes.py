"""Vectors along turned axes. A rotation is nine numbers, row by row: its rows are the unit vectors of the axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def to_axes(rotation: Sequence[float], x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Return the components of a vector along the axes of a rotation (9,); elementwise."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = rotation
    return xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z


def from_axes(rotation: Sequence[float], u: Any, v: Any, w: Any) -> tuple[Any, Any, Any]:
    """Return the vector with these components along the axes of a rotation (9,); elementwise."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = rotation
    return xx * u + yx * v + zx * w, xy * u + yy * v + zy * w, xz * u + yz * v + zz * w
