"""The run file: what binding gives, round trips, changed values, the examples."""

import json
import math
import pickle
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from pydantic import Field
from runfiles import BASE, EXAMPLES, changed, error_of

import streamkit as sk
from streamkit.runfile import as_spec, literal, to_toml
from streamkit.runfile.reader import DEFAULT_KIND


def test_names_priors_and_units_in_file_order() -> None:
    spec = sk.load(BASE)
    assert spec.names == ("potential.v0", "progenitor.mass", "progenitor.lookback", "stripping.sigma")
    assert spec.units == ("km/s", "Msun", "Gyr", "km/s")
    np.testing.assert_allclose(spec.centre(), [220.0, math.sqrt(1e17), 5.0, 10.0])
    turned = {"stripping": BASE["stripping"]} | BASE
    assert sk.load(turned).names[0] == "stripping.sigma"


def test_bind_gives_the_components_at_the_values() -> None:
    inputs = sk.load(BASE).bind(np.array([200.0, 5e8, 3.0, 9.0]))
    assert inputs.potentials["potential"].model_dump(exclude_none=True) == {"v0": 200.0, "rs": 12.0, "alpha": 0.45}
    assert inputs.satellite.model_dump(exclude_none=True) == {"mass": 5e8, "radius": 0.85}
    assert (inputs.mass, inputs.lookback, inputs.seed) == (5e8, 3.0, 7)
    assert inputs.stripping.model_dump()["sigma"] == 9.0
    assert (inputs.integrator.kind, inputs.observable) == (DEFAULT_KIND["integrator"], None)
    np.testing.assert_array_equal(inputs.q, [19.0, 0.0, -5.7])
    np.testing.assert_array_equal(inputs.v, [176.0, 0.0, 202.0])
    assert list(inputs.values) == list(sk.load(BASE).names)


def test_bind_by_name_leaves_the_others_at_their_centre() -> None:
    values = sk.load(BASE).bind({"potential.v0": "0.2 Mpc / Gyr"}).values
    assert values["potential.v0"] == pytest.approx((0.2 * u.Mpc / u.Gyr).to_value(u.km / u.s))
    assert values["stripping.sigma"] == 10.0


def test_a_free_sun_moves_the_progenitor() -> None:
    sky = {"l": 0, "b": 0, "distance": 25, "pm_l_cosb": 0, "pm_b": 0, "v_los": 100, "lookback": 3}
    document = changed("progenitor", {"kind": "plummer", "mass": 1e8, "radius": 1} | sky)
    spec = sk.load(document | {"sun": {"r0": {"normal": [8.2, 0.1]}}})
    assert "sun.r0" in spec.names
    near, far = (spec.bind({"sun.r0": r0}).q for r0 in (8.0, 8.5))
    np.testing.assert_allclose(far - near, [-0.5, 0.0, 0.0], atol=1e-12)


def test_several_potentials_by_name() -> None:
    halo = {"kind": "nfw", "mass": {"uniform": [1e11, 1e12]}, "rs": 10}
    spec = sk.load(changed("potential", {"halo": halo, "bulge": {"kind": "hernquist", "mass": 3e10, "a": 0.5}}))
    assert spec.names[0] == "potential.halo.mass"
    inputs = spec.bind({"potential.halo.mass": 2e11})
    assert {name: part.kind for name, part in inputs.potentials.items()} == {
        "halo": "nfw",
        "bulge": "hernquist",
    }
    assert inputs.potentials["halo"].model_dump()["mass"] == 2e11
    assert [path for path, _, _ in spec.components()][:3] == [
        "potential.halo",
        "potential.bulge",
        "progenitor",
    ]
    assert sk.load(spec.document) == spec


def test_values_outside_a_field_are_out_of_domain() -> None:
    spec = sk.load(changed("stripping", "sigma", {"normal": [1, 10]}))
    with pytest.raises(sk.OutOfDomain, match=r"^stripping\.sigma is outside its allowed range$"):
        spec.bind({"stripping.sigma": -1.0})
    with pytest.raises(sk.OutOfDomain, match=r"^progenitor\.lookback is outside"):
        spec.bind({"progenitor.lookback": 0.0})  # the prior may end on an open bound


@pytest.mark.parametrize(
    ("theta", "part"),
    [
        ({"potential.v00": 1}, "Did you mean 'potential.v0'?"),
        ({"potential.rs": 1}, "fixed in the run file"),
        ({"potential.v0": "1 kpc"}, "potential.v0: expected a quantity in km/s"),
        (np.zeros(3), "shape (3,), expected (4,)"),
    ],
)
def test_bind_refuses_what_is_not_free(theta: Any, part: str) -> None:
    with pytest.raises(sk.SpecError) as caught:
        sk.load(BASE).bind(theta)
    assert part in str(caught.value)


def test_quantities_and_numpy_numbers_in_a_mapping() -> None:
    document = changed("potential", "rs", 12000 * u.pc)
    document["stripping"] |= {
        "particles": np.int64(50),
        "sigma": {"uniform": (1 * u.km / u.s, np.float64(3))},
    }
    spec = sk.load(document)
    assert spec.document["potential"]["rs"] == "12.0 kpc"
    assert spec.document["stripping"]["particles"] == 50
    assert spec.document["stripping"]["sigma"] == {"uniform": ["1.0 km/s", "3.0 km/s"]}


def test_round_trips() -> None:
    spec = sk.load(BASE)
    text = spec.toml()
    assert text.startswith("# Resolved from")
    for other in (
        sk.load(spec.document),
        sk.load(json.loads(json.dumps(spec.document))),
        sk.load(tomllib.loads(text)),
        pickle.loads(pickle.dumps(spec)),
    ):
        assert other == spec
        assert hash(other) == hash(spec)
        assert other.digest() == spec.digest()
    assert spec.document["sun"]["v_circ"] == "237.0 km/s"  # defaults filled in
    assert sk.load(BASE | {"integrator": {"kind": "pefrl", "step": "2 Myr"}}).document["integrator"] == {
        "kind": "pefrl", "step": "0.002 Gyr"
    }  # fmt: skip


def test_digest_sees_the_physics_only() -> None:
    digest = sk.load(BASE).digest()
    assert sk.load(BASE | {"sampler": {"steps": 9, "tau_factor": 10, "r_hat": 1.1}}).digest() == digest
    assert sk.load(changed("potential", "rs", "12000 pc")).digest() == digest
    for other in (
        changed("seed", 8),
        changed("potential", "rs", 12.1),
        changed("stripping", "kind", "streakline"),
        BASE | {"sampler": {"walkers": 48}},
        BASE | {"likelihood": {"noise": "add"}},
        {"stripping": BASE["stripping"]} | BASE,  # another order of the chain's columns
    ):
        assert sk.load(other).digest() != digest


def test_with_values_replaces_fixes_and_frees() -> None:
    spec = sk.load(BASE)
    new = spec.with_values(
        {
            "progenitor.mass": "6.4e8 Msun",
            "potential.rs": {"normal": [12, 1]},
            "stripping.particles": 20,
            "seed": 3,
        }
    )
    assert new.names == ("potential.v0", "potential.rs", "progenitor.lookback", "stripping.sigma")
    inputs = new.bind()
    assert (inputs.mass, inputs.stripping.particles, inputs.seed) == (6.4e8, 20, 3)
    assert spec == sk.load(BASE)  # untouched


def test_with_values_changes_a_kind_and_keeps_what_was_set() -> None:
    new = sk.load(BASE).with_values({"stripping.kind": "streakline", "integrator.kind": "dop853"})
    assert new.document["stripping"] == sk.load(changed("stripping", "kind", "streakline")).document["stripping"]
    assert new.document["integrator"] == {"kind": "dop853", "rtol": 1e-10, "atol": 1e-10}
    leap = sk.load(BASE).with_values({"integrator.step": "1 Myr", "integrator.kind": "leapfrog"})
    assert leap.document["integrator"] == {"kind": "leapfrog", "step": "0.001 Gyr"}
    seen = sk.load(BASE).with_values({"observable.leading": ["47.8 kpc", "0.5 kpc"]})
    assert seen.document["observable"]["kind"] == "apocentres"


def test_with_values_drops_the_fields_that_a_new_kind_lacks() -> None:
    spec, changes = sk.load(BASE), {"stripping.kind": "restricted_nbody", "stripping.particles": 60}
    assert spec.dropped_by(changes) == ["stripping.sigma"]
    live = spec.with_values(changes)
    assert "sigma" not in live.document["stripping"]
    assert live.names == ("potential.v0", "progenitor.mass", "progenitor.lookback")
    assert live.dropped_by({"stripping.kind": "mlcs"}) == []
    halo = {"potential.kind": "kepler", "potential.mass": 1e12}
    assert spec.dropped_by(halo) == ["potential.v0", "potential.rs", "potential.alpha"]
    assert spec.with_values(halo).document["potential"]["kind"] == "kepler"
    with pytest.raises(sk.SpecError, match="'restricted_nbody' has no field 'sigma'"):
        spec.with_values(changes | {"stripping.sigma": 4.0})


@pytest.mark.parametrize(
    ("path", "value", "part"),
    [
        ("progenitor.masss", 1, "no field 'progenitor.masss'. Did you mean 'progenitor.mass'?"),
        ("mass", 1, "no field 'mass'"),
        ("potential.v0.uniform", [1, 2], "no field 'potential.v0.uniform'"),
        ("seed.x", 1, "no field 'seed.x'"),
        ("bar.kind", "tf", "no field 'bar.kind'"),
        ("progenitor.mass", -1, "progenitor.mass: found -1 Msun, should be greater than 0"),
        ("stripping.particles", "20", "found '20', expected a whole number"),
    ],
)
def test_with_values_is_as_strict_as_the_file(path: str, value: Any, part: str) -> None:
    with pytest.raises(sk.SpecError) as caught:
        sk.load(BASE).with_values({path: value})
    assert part in str(caught.value)


def test_a_field_name_that_a_coordinate_has_too() -> None:
    place = {key: value for key, value in BASE["progenitor"].items() if key not in ("kind", "radius")}
    spec = sk.load(changed("progenitor", {"kind": "isochrone", "b": 0.5} | place))
    assert spec.bind().satellite.model_dump()["b"] == 0.5
    sky = {"l": 5, "distance": 25, "pm_l_cosb": 0, "pm_b": 0, "v_los": 0, "lookback": 3}
    message = error_of(changed("progenitor", {"kind": "isochrone", "mass": 1e8, "b": -14} | sky))
    assert "Galactic sky is not available here" in message


@pytest.mark.parametrize("text", ["6.4e8", "true", "12", '"a b"', "[1, 2]", "{ normal = [1, 2] }"])
def test_literal_reads_as_toml_does(text: str) -> None:
    assert literal(text) == tomllib.loads(f"v = {text}")["v"]


@pytest.mark.parametrize("text", ["6.4e8 Msun", "mlcs", "", "1 kpc\n[x]"])
def test_literal_takes_the_rest_as_text(text: str) -> None:
    assert literal(text) == text


def test_toml_writer_is_read_back() -> None:
    document = {
        "version": 1, "plugins": ['a "b"\\c.py', "é\x7f\n"],
        "potential": {"h-1": {"kind": "x", "m": {"uniform": ["1.0 kpc", math.inf]}, "on": False}},
        "sun": {"r0": -1e-300, "big": 6.4e8, "odd key": 1e22},
    }  # fmt: skip
    assert tomllib.loads(to_toml(document, "one\ntwo")) == document
    with pytest.raises(TypeError, match="no form for None"):
        to_toml({"a": None})


def test_toml_has_sections_as_tables_priors_inline_and_the_order_of_the_keys() -> None:
    document = {
        "seed": 1, "stripping": {"kind": "mlcs", "sigma": {"normal": [10, 1]}, "particles": 20},
        "potential": {"z": {"kind": "nfw", "rs": {"uniform": [1, 2]}, "mass": 1.0}, "a": {"kind": "x", "m": 2.0}},
    }  # fmt: skip
    text = to_toml(document)
    assert [line for line in text.splitlines() if line.startswith("[")] == [
        "[stripping]", "[potential.z]", "[potential.a]"
    ]  # fmt: skip
    assert "sigma = {normal = [10, 1]}" in text
    assert json.dumps(tomllib.loads(text)) == json.dumps(document)  # the order too


def test_symbols_of_the_free_parameters() -> None:
    spec = sk.load(next(path for path in EXAMPLES if path.stem == "sagittarius"))
    assert dict(zip(spec.names, spec.symbols, strict=True)) == {
        "potential.v0": r"$v_0$",
        "potential.rs": r"$r_{\rm s}$",
        "potential.alpha": r"$\alpha$",
        "progenitor.mass": r"$M_{\rm sat}$",
        "progenitor.radius": r"$a_{\rm sat}$",
        "progenitor.distance": r"$d$",
        "progenitor.pm_l_cosb": r"$\mu_l \cos b$",
        "progenitor.pm_b": r"$\mu_b$",
        "progenitor.v_los": r"$v_{\rm los}$",
        "progenitor.lookback": r"$t_{\rm back}$",
        "stripping.sigma": r"$\sigma$",
    }
    sun = sk.load(BASE | {"sun": {"r0": {"normal": [8, 1]}, "v_circ": {"normal": [237, 9]}}})
    assert sun.symbols[-2:] == (r"$R_0$", r"$v_{\rm c}(R_0)$")


def test_symbols_say_whose_they_are_and_fall_back_to_the_path() -> None:
    halo = {"kind": "nfw", "mass": {"uniform": [1e11, 1e12]}, "rs": {"uniform": [5, 20]}}
    disc = {"kind": "hernquist", "mass": {"uniform": [1e9, 1e11]}, "a": 0.5}
    document = changed("potential", {"halo": halo, "thin_disc": disc})
    document["stripping"] |= {"burst_width": {"uniform": [0.1, 0.2]}}
    assert dict(zip((spec := sk.load(document)).names, spec.symbols, strict=True)) == {
        "potential.halo.mass": r"$M_{\rm halo}$",
        "potential.halo.rs": r"$r_{\rm s}^{\rm halo}$",
        "potential.thin_disc.mass": r"$M_{\rm thin\_disc}$",
        "progenitor.mass": r"$M_{\rm sat}$",
        "progenitor.lookback": r"$t_{\rm back}$",
        "stripping.sigma": r"$\sigma$",
        "stripping.burst_width": "stripping.burst_width",
    }


class Foreign(sk.Potential):
    """A sphere whose fields have no symbols, as those of many plugins."""

    kind = "foreign_symbols"
    m: sk.Mass = Field(description="Mass.")
    r_s: sk.Length = Field(description="Radius.")
    q1: sk.PositiveNumber = Field(description="Axis ratio.")
    beta_0: sk.Number = Field(description="Slope.")
    concentration: sk.PositiveNumber = Field(description="A word.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, m: Any, r_s: Any, q1: Any, beta_0: Any, concentration: Any) -> Any:
        k = -sk.G * m / (x * x + y * y + z * z + r_s * r_s) ** 1.5
        return k * x, k * y, k * z


def test_fields_without_a_symbol_have_that_of_their_name() -> None:
    prior = {"uniform": [1, 2]}
    fields = dict.fromkeys(("m", "r_s", "q1", "beta_0", "concentration"), prior)
    spec = sk.load(changed("potential", {"kind": "foreign_symbols"} | fields), components=[Foreign])
    assert spec.symbols[:5] == ("$m$", r"$r_{\rm s}$", "$q_{1}$", r"$\beta_{0}$", "potential.concentration")


def test_a_path_or_a_mapping_stands_for_a_spec(tmp_path: Path) -> None:
    spec = sk.load(BASE)
    (tmp_path / "run.toml").write_text(spec.toml())
    assert as_spec(spec) is spec
    for source in (tmp_path / "run.toml", str(tmp_path / "run.toml"), BASE):
        assert as_spec(source) == spec
        assert sk.Model(source).spec == spec
    fit = BASE | {"observable": {"leading": [50, 1]}}
    assert sk.Posterior(fit).spec == sk.load(fit)
    with pytest.raises(sk.SpecError, match="observable"):  # it was read, and has nothing to fit
        sk.run(tmp_path / "run.toml", progress=False)


@pytest.mark.parametrize("entry", [as_spec, sk.load, sk.Model, sk.Posterior, sk.run])
@pytest.mark.parametrize("source", [None, 3])
def test_anything_else_is_refused_at_once(entry: Any, source: Any) -> None:
    with pytest.raises(sk.SpecError, match=f"found {source}, expected a spec, the path of a run file, or a mapping"):
        entry(source)


def test_the_door_completes() -> None:
    assert {"load", "run", "Model", "Results", "Spec", "Posterior", "Symbol"} <= set(dir(sk))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_load_and_round_trip(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = sk.load(path)
    monkeypatch.chdir(path.parent)  # what the names of files in a mapping are relative to
    assert sk.load(tomllib.loads(spec.toml())) == spec
    spec.bind_all()


def test_the_sagittarius_example_is_the_papers_setting() -> None:
    spec = sk.load(next(path for path in EXAMPLES if path.stem == "sagittarius"))
    known = dict(zip(spec.names, spec.priors, strict=True))
    assert len(known) == 11
    assert {name: tuple(vars(prior).values()) for name, prior in known.items()} == {
        "potential.v0": (40, 400), "potential.rs": (1, 100), "potential.alpha": (0, 1),
        "progenitor.mass": (1e8, 1e9), "progenitor.radius": (0.1, 1), "stripping.sigma": (0.5, 10),
        "progenitor.distance": (22.0, 28.4), "progenitor.v_los": (153, 2), "progenitor.lookback": (0, 10),
        "progenitor.pm_l_cosb": (-2.44, 0.3), "progenitor.pm_b": (1.97, 0.3),
    }  # fmt: skip
    assert spec.document["sun"] == {
        "r0": "8.0 kpc", "v_circ": "237.0 km/s", "u": "11.1 km/s", "v": "12.24 km/s",
        "w": "7.25 km/s", "z": "0.0 kpc",
    }  # fmt: skip
    assert spec.document["observable"]["recent_debris"] == "literal"


def test_a_spec_and_a_model_print_as_one_short_line():
    spec = sk.load(changed("potential", {"kind": "kepler", "mass": {"uniform": [1e11, 2e11]}}))
    assert repr(spec) == f"<Spec of run mapping; free: {', '.join(spec.names)}>"
    assert repr(sk.Model(spec)) == f"<Model of {spec!r}>"
    assert len(repr(spec)) < 200
