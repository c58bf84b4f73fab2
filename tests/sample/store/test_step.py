"""Steps as samplers give them: a step is stored as it is, or is an error of the sampler before anything is written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streamkit as sk
from streamkit.sample import ChainFile, blob_dtype, read_chain_file
from streamkit.sample.store.step import Step

WALKERS, D, M = 4, 2, 3
TWISTER = np.random.RandomState(1).get_state()
GENERATORS = "PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64"


def step(number: int, **changes: Any) -> Step:
    """Return a step with some of its entries changed."""
    rng = np.random.default_rng(number)
    whole: dict[str, Any] = {
        "coords": rng.random((WALKERS, D)),
        "log_prob": -rng.random(WALKERS),
        "blobs": np.zeros(WALKERS, dtype=blob_dtype(M)),
        "accepted": np.ones(WALKERS, dtype=bool),
        "random_state": TWISTER,
    }
    return Step(number, **whole | changes)


def stored(path: Path, *steps: Step) -> ChainFile:
    """Store a start and steps, by the journal and then by the chain file."""
    file = ChainFile(path / "chain.h5")
    file.reset(WALKERS, D)
    for each in (step(0), *steps):
        file.append(each)
    file.consolidate()
    return file


@pytest.mark.parametrize("dtype", ["i8", "u1", "i4", "f4", "f2", "?", ">f8", "f8"])
def test_arrays_of_numbers_are_read_as_they_were_given(tmp_path: Path, dtype: str) -> None:
    values = np.array([0, 1, 1], dtype=dtype)
    steps = [step(n, memory={"counter": values}) for n in (1, 2)]
    stored(tmp_path, *steps)
    chain = read_chain_file(tmp_path / "chain.h5")
    assert chain.memory["counter"].dtype == values.dtype.newbyteorder("=")
    np.testing.assert_array_equal(chain.memory["counter"], values)


def test_points_of_other_numbers_become_floats(tmp_path: Path) -> None:
    coords = np.arange(WALKERS * D, dtype="f4").reshape(WALKERS, D)
    stored(tmp_path, step(1, coords=coords, log_prob=[-1, -2, -3, -4], accepted=[1, 0, 1, 0]))
    chain = read_chain_file(tmp_path / "chain.h5")
    np.testing.assert_array_equal(chain.chain[0], coords)
    np.testing.assert_array_equal(chain.log_prob[0], [-1.0, -2.0, -3.0, -4.0])
    np.testing.assert_array_equal(chain.accepted, [1, 0, 1, 0])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"memory": {"a": np.array([1j])}}, "memory 'a': found the type complex128"),
        ({"memory": {"a": np.array([None])}}, "memory 'a': found the type object"),
        ({"memory": {"a": np.array(["x"])}}, "memory 'a': found the type <U1"),
        ({"memory": {"a/b": np.zeros(1)}}, "found the name 'a/b' of an array"),
        ({"memory": {3: np.zeros(1)}}, "found the name 3 of an array"),
        ({"memory": None}, "memory: found None"),
        ({"log_prob": np.full(WALKERS, np.nan)}, "log_prob holds NaN"),
        ({"log_prob": np.full(WALKERS, -np.inf)}, "log_prob holds NaN or infinite"),
        ({"log_prob": np.zeros(WALKERS, dtype=complex)}, "ln p: found the type complex128"),
        ({"log_prob": np.zeros(1)}, "log_prob is no array of floats of shape"),
        ({"coords": [[1, 2], [3]]}, "inhomogeneous"),
        ({"coords": np.zeros((WALKERS, D + 1))}, "the points: found float64 of shape (4, 3), expected"),
        ({"accepted": np.full(WALKERS, 2)}, "accepted: found other values"),
        ({"accepted": [True]}, "accepted holds no truth value for each walker"),
        ({"counts": {"facts": {"n": 3}}}, "counts.facts.n: Input should be a valid string, found 3"),
        ({"counts": {"calls": -1}}, "counts.calls: "),
        ({"random_state": None}, "random_state is neither"),
        ({"random_state": np.random.default_rng(1)}, "random_state is neither"),
        ({"random_state": ("MT19937", TWISTER[1], 10**9, 0, 0.0)}, "random_state is neither"),
        ({"random_state": {"bit_generator": "PCG64"}}, "random_state is neither"),
    ],
)
def test_a_step_that_could_not_be_read_is_an_error_before_it_is_written(
    tmp_path: Path, changes: dict[str, Any], reason: str
) -> None:
    with pytest.raises(sk.ComponentError, match=r"^a step cannot be stored: ") as caught:
        stored(tmp_path, step(1), step(2, **changes))
    assert reason in str(caught.value)
    np.testing.assert_array_equal(read_chain_file(tmp_path / "chain.h5").chain, [step(1).coords])


def test_memory_is_that_of_the_last_step_alone(tmp_path: Path) -> None:
    """Its names and types may change from step to step."""
    file = stored(tmp_path, step(1, memory={"a": np.array([1]), "b": np.array([7])}))
    file.append(step(2, memory={"a": np.array([1.5])}))
    file.consolidate()
    memory = read_chain_file(tmp_path / "chain.h5").memory
    assert list(memory) == ["a"]
    np.testing.assert_array_equal(memory["a"], [1.5])


@pytest.mark.parametrize("name", GENERATORS)
def test_the_state_of_any_generator_of_numpy_goes_on_with_the_same_numbers(tmp_path: Path, name: str) -> None:
    generator = np.random.Generator(getattr(np.random, name)(5))
    generator.random(700)
    stored(tmp_path, step(1, random_state=generator.bit_generator.state))
    other = np.random.Generator(getattr(np.random, name)(6))
    other.bit_generator.state = read_chain_file(tmp_path / "chain.h5").random_state
    np.testing.assert_array_equal(other.random(9), generator.random(9))


def test_control_characters_of_facts_and_reasons_are_not_stored(tmp_path: Path) -> None:
    counts = {"reasons": {"no\nstream\x1b[2J": 3}, "facts": {"size": "2 \ud800"}}
    stored(tmp_path, step(1, counts=counts))
    found = read_chain_file(tmp_path / "chain.h5").attributes["counts"]
    assert found == {"reasons": {"no stream?[2J": 3}, "facts": {"size": "2 ?"}}
