"""The elementary functions as machine code."""

import numpy as np
from numba import njit

import streamkit as sk
from streamkit.engine import vector  # noqa: F401  compiles the elementary functions


@njit
def compiled_log(x):
    return sk.log(x)


@njit
def compiled_exp(x):
    return sk.exp(x)


@njit
def compiled_power(x, y):
    return sk.power(x, y)


@njit
def compiled_sqrt(x):
    return sk.sqrt(x)


def apply(function, *columns):
    return np.array([function(*map(float, row)) for row in zip(*columns, strict=True)])


def test_compiled_log_is_numpys():
    step = np.geomspace(1e-15, 0.4, 400)
    result = 1.0 + np.concatenate([-step, step])
    for x in (np.geomspace(1e-300, 1e300, 4000), result):
        assert np.allclose(apply(compiled_log, x), np.log(x), rtol=1e-14, atol=0)


def test_compiled_exp_is_numpys():
    x = np.concatenate([np.linspace(-700, 700, 4001), np.linspace(-1e-3, 1e-3, 101)])
    assert np.allclose(apply(compiled_exp, x), np.exp(x), rtol=1e-14, atol=0)


def test_compiled_power_is_numpys():
    """exp(y ln x) loses |y ln x| units in the last place; the powers in potentials are small."""
    rng = np.random.default_rng(3)
    x, y = 10.0 ** rng.uniform(-6, 6, 2000), rng.uniform(-3, 3, 2000)
    error = np.abs(apply(compiled_power, x, y) / x**y - 1)
    assert (error <= 1e-14 + 3e-16 * np.abs(y * np.log(x))).all()
    assert np.allclose(sk.power(x, y), x**y, rtol=1e-13)


def test_compiled_sqrt_is_numpys():
    x = np.geomspace(1e-300, 1e300, 1000)
    assert np.array_equal(apply(compiled_sqrt, x), np.sqrt(x))
