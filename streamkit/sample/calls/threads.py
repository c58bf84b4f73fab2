"""One thread for linear algebra: more would be more than the cores, and the last bits of a product depend on them."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any


def one_thread() -> AbstractContextManager[Any]:
    """Have NumPy's products and solutions made by one thread from now on, until the context ends if it is entered.

    Nothing happens without threadpoolctl; ``OMP_NUM_THREADS=1`` in the environment does the same.
    """
    try:
        import threadpoolctl  # optional: it comes with scikit-learn, joblib or nautilus
    except ImportError:
        return nullcontext()
    limits: AbstractContextManager[Any] = threadpoolctl.threadpool_limits(1, user_api="blas")
    return limits
