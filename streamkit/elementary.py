"""Elementary functions for potentials: NumPy on arrays, vectorising polynomials inside the compiled loop.

`log`, `exp` and `power` of NumPy become calls to the scalar C library when numba compiles them, and the loop
around them stays scalar. These names are replaced by straight arithmetic (see ``engine/vector.py``), so that an
`acceleration` that uses them runs on all lanes of the processor.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def log(x: Any) -> Any:
    """Natural logarithm of a positive number."""
    return np.log(x)


def exp(x: Any) -> Any:
    """Exponential function."""
    return np.exp(x)


def power(x: Any, y: Any) -> Any:
    """Return ``x ** y`` for positive x."""
    return np.exp(y * np.log(x))


def sqrt(x: Any) -> Any:
    """Square root."""
    return np.sqrt(x)
