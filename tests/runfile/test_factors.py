"""The factors of a likelihood, and a spec of some of its streams."""

import numpy as np
import pytest
from runfiles import EXAMPLES, FIT, several

import streamkit as sk
from streamkit.errors import SpecError
from streamkit.model import Model

FOUR = next(path for path in EXAMPLES if path.stem == "four_streams")
OWN = {"gd1": 5, "pal5": 3, "orphan": 5, "phoenix": 4}  # priors in their sections of the run file


def test_factors_of_four_streams_share_the_host_alone() -> None:
    spec = sk.load(FOUR)
    shared = [name for name in spec.names if not name.startswith("stream.")]
    halo = [f"potential.halo.{name}" for name in ("mass", "rs", "q")]
    assert shared == ["potential.disc.mass", *halo, "body.lmc.mass"]
    assert {each.name: len(each.own) for each in spec.factors} == OWN | {"[data]": 0}
    for factor in spec.factors:
        assert [spec.names[i] for i in factor.shared] == shared
        assert all(spec.names[i].startswith(f"stream.{factor.name}.") for i in factor.own)
        np.testing.assert_array_equal(factor.parameters, np.sort([*factor.shared, *factor.own]))


def test_a_free_number_of_the_hosts_data_belongs_to_these_and_a_free_sun_to_all() -> None:
    curve = {"kind": "circular_velocity", "radius": 8.0, "v_c": [229, 7]}
    spec = sk.load(several("a", "b", data={"curve": curve}, sun={"r0": {"normal": [8.2, 0.1]}}))
    assert [each.name for each in spec.factors] == ["a", "b", "[data]"]
    assert "sun.r0" in [spec.names[i] for i in spec.factors[0].shared]
    assert [spec.names[i] for i in spec.factors[1].own] == ["stream.b.progenitor.v_los"]


def test_one_stream_is_one_factor_with_all_parameters() -> None:
    for document in (FIT, several("a")):
        spec = sk.load(document)
        assert [each.name for each in spec.factors] == list(spec.streams)
        np.testing.assert_array_equal(spec.factors[0].own, np.arange(len(spec.names)))
        assert not len(spec.factors[0].shared)


def test_a_part_is_the_same_stream_with_the_same_parameters_and_files() -> None:
    whole = sk.load(FOUR)
    alone = whole.only("pal5", data=False)
    factor = next(each for each in whole.factors if each.name == "pal5")
    assert alone.names == tuple(whole.names[i] for i in factor.parameters)
    assert alone.streams == ("pal5",)
    assert not alone.sections.data
    assert set(alone.files) == {"../pal5/phi2.ecsv", "../pal5/radial_velocity.ecsv"}
    theta = whole.centre()
    stream = Model(whole, fresh=False).stream(theta, "pal5")
    np.testing.assert_array_equal(stream.q, Model(alone).stream(theta[factor.parameters]).q)


def test_the_product_of_the_parts_is_the_likelihood() -> None:
    curve = {"curve": {"kind": "circular_velocity", "radius": 8.0, "v_c": [229, 7]}}
    whole = sk.load(several("a", "b", data=curve))
    theta = whole.centre() + 0.1
    total = sk.Posterior(whole).evaluate(theta).ln_likelihood
    parts = 0.0
    for name, data in (("a", True), ("b", False)):
        factor = next(each for each in whole.factors if each.name == name)
        parts += sk.Posterior(whole.only(name, data=data)).evaluate(theta[factor.parameters]).ln_likelihood
    assert parts == pytest.approx(total, rel=1e-12)


def test_the_digest_of_a_part_knows_nothing_of_other_streams_or_of_the_data_left_out() -> None:
    curve = {"curve": {"kind": "circular_velocity", "radius": 8.0, "v_c": [229, 7]}}
    two, three = sk.load(several("a", "b")), sk.load(several("a", "b", "c", data=curve))
    assert two.only("a").digest() == three.only("a", data=False).digest() != three.only("a").digest()
    assert two.only("a").digest() != two.only("b").digest() != two.digest()
    assert two.only("a", "b").digest() == two.only().digest() == two.digest()
    changed = two.with_values({"stream.b.stripping.sigma": 5.0})
    assert two.only("a").digest() == changed.only("a").digest()
    assert two.only("b").digest() != changed.only("b").digest()


def test_only_one_stream_without_a_name() -> None:
    spec = sk.load(FIT)
    assert spec.only("stream") == spec


def test_a_wrong_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(SpecError, match=r"no stream is called 'gd'.*'gd1'.*gd1, pal5, orphan, phoenix"):
        sk.load(FOUR).only("gd")


def test_check_says_who_shares_what() -> None:
    from streamkit.study.preflight import describe_spec

    text = describe_spec(sk.load(FOUR))
    assert "each depends on the host (5 parameters)" in text
    for name, count in OWN.items():
        assert f"{name}" in text
        assert f"{count} parameters of its own" in text
    assert "of its own" not in describe_spec(sk.load(FIT))


def test_without_observables_the_data_of_the_host_are_left() -> None:
    curve = {"curve": {"kind": "circular_velocity", "radius": 8.0, "v_c": [229, 7]}}
    alone = sk.load(several("a", "b", data=curve)).only("a", observables=False)
    assert alone.sections.streams["a"].observables == {}
    assert list(alone.sections.data) == ["curve"]
    assert sk.load(FIT).only(observables=False).sections.streams["stream"].observables == {}


def test_the_digest_without_the_sampler_is_that_of_the_posterior() -> None:
    spec = sk.load(several("a", "b"))
    other = spec.with_sampler("emulator")
    assert spec.digest() != other.digest()
    assert spec.digest(sampler=False) == other.digest(sampler=False)
    assert spec.digest(sampler=False) != spec.with_values({"stream.a.stripping.sigma": 5.0}).digest(sampler=False)
