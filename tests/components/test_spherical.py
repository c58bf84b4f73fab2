"""`streamkit.Spherical`: a sphere by its pull is the same force as by its acceleration."""

import numpy as np
import pytest

import streamkit as sk
from streamkit.components import load_registry
from streamkit.engine import build_field
from streamkit.engine.cache import content_digest


class ByPull(sk.Spherical):
    """A Plummer sphere by its pull."""

    kind = "by_pull"
    mass: sk.TotalMass
    b: sk.Length

    @staticmethod
    def pull(r2, mass, b):
        return -sk.G * mass / ((r2 + b * b) * sk.sqrt(r2 + b * b))

    @staticmethod
    def well(r2, mass, b):
        return -sk.G * mass / np.sqrt(r2 + b * b)


class ByAcceleration(sk.Potential):
    """The same by its acceleration."""

    kind = "by_acceleration"
    mass: sk.TotalMass
    b: sk.Length

    @staticmethod
    def acceleration(x, y, z, t, mass, b):
        r2 = x * x + y * y + z * z
        k = -sk.G * mass / ((r2 + b * b) * sk.sqrt(r2 + b * b))
        return k * x, k * y, k * z


Q = np.random.default_rng(3).normal(size=(3, 100)) * 10
FIELDS = {"mass": 1e11, "b": 3.0}


def test_the_compiled_force_is_that_of_the_acceleration_bit_for_bit():
    forces = [build_field([cls(**FIELDS)]).acceleration(0.0, Q) for cls in (ByPull, ByAcceleration)]
    np.testing.assert_array_equal(*forces)


def test_numpy_has_the_force_and_the_energy():
    x, y, z = Q
    expected = ByAcceleration.acceleration(x, y, z, 0.0, 1e11, 3.0)
    np.testing.assert_allclose(ByPull.acceleration(x, y, z, 0.0, 1e11, 3.0), expected, rtol=1e-14)
    np.testing.assert_allclose(
        ByPull.potential(x, y, z, 0.0, 1e11, 3.0), -sk.G * 1e11 / np.hypot(3.0, np.linalg.norm(Q, axis=0))
    )
    assert ByPull.has_energy()


def test_there_is_no_force_at_the_centre():
    assert not build_field([ByPull(**FIELDS)]).acceleration(0.0, np.zeros((3, 1))).any()


def test_the_compiled_code_is_kept_by_the_content_of_the_pull():
    digests = [content_digest(load_registry().find("potential", kind, "").pull, 2) for kind in ("nfw", "plummer")]
    assert None not in digests
    assert len({*digests, content_digest(ByPull.pull, 2)}) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("r2, mass", r"Wrong\.pull: the arguments must be \(r2, mass, b\), that is r2 and then the fields by name"),
        ("x, y, z, t, mass, b", r"found \(x, y, z, t, mass, b\)"),
    ],
)
def test_another_signature_is_refused_where_the_class_is_written(tmp_path, arguments, message):
    (tmp_path / "wrong.py").write_text(
        "from streamkit import Length, Mass, Spherical, hookimpl\nclass Wrong(Spherical):\n    kind = 'wrong'\n"
        f"    mass: Mass\n    b: Length\n    @staticmethod\n    def pull({arguments}):\n        return -mass\n"
    )
    with pytest.raises(sk.PluginError, match=message):
        load_registry([tmp_path / "wrong.py"])
