"""One thread for linear algebra: more would be more than the cores, and the last bits of a product depend on them."""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib import import_module
from typing import Any

# Packages with a separate linear algebra library: the limit does not apply to libraries that are loaded later.
LIBRARIES = ("numpy", "scipy.linalg")


def one_thread() -> AbstractContextManager[Any]:
    """Have the products and solutions of NumPy and SciPy made by one thread from now on, until an entered context ends.

    The samples of a run then do not depend on the number of cores, or on ``OPENBLAS_NUM_THREADS``.
    """
    from threadpoolctl import threadpool_limits

    for name in LIBRARIES:
        import_module(name)
    limits: AbstractContextManager[Any] = threadpool_limits(1, user_api="blas")
    return limits
