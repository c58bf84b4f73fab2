"""A component whose fields depend on what its section says."""

import pickle
from pathlib import Path

import pytest
from runfiles import accepts, changed, schema_with

import streamkit as sk
from streamkit.runfile import to_toml

PLUGIN = '''
from functools import cache
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, create_model

from streamkit import Observable, Prediction, Unit, hookimpl


class _Densities(Observable):
    def data(self):
        return np.zeros(0), np.ones(0)

    def predict(self, stream):
        return Prediction((), np.zeros(0), np.zeros(0))

    @classmethod
    def for_section(cls, section):
        wrong = [name for name in section if not name.startswith("density_")]
        if wrong:
            raise ValueError(f"{wrong[0]} is no density")
        return with_fields(tuple(sorted(section)))


class Densities(_Densities):
    """Fields called density_1, density_2..., as many as the section has."""

    kind = "densities"


@cache
def with_fields(names):
    density = Annotated[float, Unit("Msun / kpc3")], Field(description="A density.")
    kind = ClassVar[str], "densities"
    return create_model("Densities", __base__=_Densities, kind=kind, **dict.fromkeys(names, density))


@hookimpl
def streamkit_components():
    return [Densities]
'''


@pytest.fixture
def load(tmp_path: Path):
    (tmp_path / "densities.py").write_text(PLUGIN)

    def with_section(**fields):
        document = {"plugins": ["densities.py"]} | changed("observable", {"kind": "densities"} | fields)
        (tmp_path / "run.toml").write_text(to_toml(document))
        return sk.load(tmp_path / "run.toml")

    return with_section


def test_the_section_decides_which_fields_there_are(load) -> None:
    spec = load(density_1="8 Msun/pc3", density_2={"uniform": ["1 Msun/pc3", "2 Msun/pc3"]})
    assert "observable.density_2" in spec.names
    fields = spec.bind().observable.model_dump()
    assert fields == pytest.approx({"density_1": 8e9, "density_2": 1.5e9})
    again = pickle.loads(pickle.dumps(spec))
    assert (again, again.digest()) == (spec, spec.digest())
    other = spec.with_values({"observable.density_1": 1.0})
    assert other.bind().observable.density_1 == 1.0


def test_what_it_refuses_is_told_with_its_place(load) -> None:
    with pytest.raises(sk.SpecError, match=r"run\.toml: observable: mass is no density"):
        load(mass=1)
    with pytest.raises(sk.SpecError, match=r"observable\.density_1: expected a quantity in Msun/kpc3 or a unit like"):
        load(density_1="8 kpc")


def test_the_schema_leaves_its_fields_open(load) -> None:
    spec = load()
    schema = schema_with(spec.registry)
    more = {"density_7": 1.0}
    assert accepts(schema, spec.document | {"observable": {"kind": "densities"} | more}, schema)
    assert not accepts(schema, spec.document | {"integrator": {"kind": "leapfrog"} | more}, schema)
