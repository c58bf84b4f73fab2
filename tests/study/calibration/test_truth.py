"""A calibration whose truth is another run file: another family of hosts, other priors, numbers in place of priors."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import QTable
from click.testing import CliRunner
from itself import itself

import streamkit as sk
from streamkit.cli.main import main
from streamkit.study.calibration import calibrate, calibration_products, read_truths, write_mocks
from streamkit.study.calibration.compared import of_host, shares_below, true_parameters
from streamkit.study.calibration.mocks import draw_mock

FLAT = 0.8  # of the true halo's potential


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    document = itself(tmp_path_factory.mktemp("plugin")).document
    return sk.load(document | {"sampler": document["sampler"] | {"steps": 20}})


@pytest.fixture(scope="module")
def halo(spec):
    """Return a truth of another family: a logarithmic halo whose speed has a prior of its own."""
    potential = {"kind": "logarithmic_halo", "v0": {"uniform": ["150 km/s", "250 km/s"]}, "q": FLAT}
    return sk.load({**spec.document, "potential": potential})


@pytest.fixture(scope="module")
def made(spec, halo, tmp_path_factory):
    return calibrate(spec, tmp_path_factory.mktemp("made"), 3, truth=halo, radii=(10.0, 30.0))


def test_the_host_of_the_truth_is_its_own(halo, made):
    """The v0 of both families are two numbers. The potential of a logarithmic halo is v0^2 ln r and a function of
    direction."""
    assert made.names == ("mass_10", "mass_30", "v_c_8")
    *masses, v_c = made.truths.T
    assert np.unique(v_c).size == 3
    assert ((v_c > 150) & (v_c < 250)).all()
    for radius, mass in zip((10.0, 30.0), masses, strict=True):
        assert mass == pytest.approx(v_c**2 * radius / sk.G)


def test_the_flattening_is_compared_where_the_fit_has_one(spec, halo):
    """A potential of R^2 + z^2/q^2 has the axis ratio q everywhere; that of a round fit has no interval."""
    assert of_host(sk.Host(halo.host()), (10.0,))[-1] == pytest.approx(FLAT)
    assert of_host(sk.Host(spec.host()), (10.0,))[-1] == pytest.approx(1.0)
    samples = np.array([[1.0, 0.7], [1.0, 0.75], [1.0, 0.9], [1.0, 0.95]])
    assert shares_below(samples, np.array([FLAT, FLAT])) == (None, 0.5)
    assert shares_below(samples, np.array([FLAT, np.nan])) == (None, None)


def test_parameters_are_found_by_their_names(spec, halo):
    """A number in place of a prior is a truth as well. A field that is not there is none, nor one of another kind."""
    free = spec.with_values({"potential.rs": {"uniform": ["5 kpc", "30 kpc"]}})
    assert free.names == ("potential.v0", "potential.rs")
    assert halo.names == ("potential.v0",)
    assert np.isnan(true_parameters(free, halo, np.array([231.0]))).all()
    assert true_parameters(spec, wider(spec), np.array([231.0])).tolist() == [231.0]
    fixed = spec.with_values({"potential.v0": "180 km/s", "potential.rs": "0.012 Mpc"})
    assert true_parameters(free, fixed, np.zeros(0)) == pytest.approx([180.0, 12.0])
    assert true_parameters(free, free, np.array([1.0, 2.0])).tolist() == [1.0, 2.0]


def test_what_the_truth_lacks_is_told(spec, halo, tmp_path):
    free = spec.with_values({"potential.rs": {"uniform": ["5 kpc", "30 kpc"]}})
    made = calibrate(free, tmp_path, 2, truth=halo)
    assert "potential.rs" not in made.names
    assert "potential.v0" not in made.names  # of another kind of halo
    products = calibration_products(made)
    text = " ".join(products.text.split())
    assert "Not compared, as the truth has none of the same kind: potential.rs, potential.v0." in text
    assert products.header["truth"]["potential"]["kind"] == "logarithmic_halo"


def wider(spec):
    return spec.with_values({"potential.v0": {"uniform": ["150 km/s", "250 km/s"]}})


def test_truths_outside_the_priors_of_the_fit_are_counted(spec, tmp_path):
    """Of speeds between 150 and 250 km/s, those below a prior's end have no interval that could hold them."""
    made = calibrate(spec, tmp_path, 3, truth=wider(spec))
    assert made.names[0] == "potential.v0"
    middle = float(np.sort(made.truths[:, 0])[1])
    narrow = spec.with_values({"potential.v0": {"uniform": [f"{middle} km/s", "260 km/s"]}})
    told = replace(made, spec=narrow)
    assert told.beyond_priors == {"potential.v0": 1}
    text = " ".join(calibration_products(told).text.split())
    assert "outside the fit's prior, where no interval can hold it: potential.v0 in 1 of 3 draws." in text


def test_draws_at_other_radii_are_not_continued(spec, halo, made, tmp_path):
    calibrate(spec, tmp_path, 1, truth=halo, radii=(10.0,))
    with pytest.raises(sk.StreamkitError, match="belong to another run file, to other settings"):
        calibrate(spec, tmp_path, 1, resume=True, truth=halo, radii=(20.0,))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"stream": {"a": {}}}, r"a section observable as the fit has it, to make its mock data; found stream\.a\.obs"),
        ({"potential": {"kind": "nfw", "mass": "1e12 Msun", "rs": "20 kpc"}}, "has none of the parameters of the fit"),
    ],
)
def test_a_truth_that_cannot_be_compared_is_refused(spec, tmp_path, change, text):
    document = dict(spec.document)
    if "stream" in change:
        named = {key: document.pop(key) for key in ("progenitor", "stripping", "observable")}
        change = {"stream": {"a": named}}
    else:  # the fit's host is fixed, so that only its own parameter could be compared
        spec = sk.load(
            {**spec.document, "potential": change["potential"],
             "progenitor": spec.document["progenitor"] | {"radius": {"uniform": ["0.1 kpc", "0.2 kpc"]}}}
        )  # fmt: skip
        document["progenitor"] = {**document["progenitor"], "kind": "kepler"}
        document["progenitor"].pop("radius")
    truth = sk.load(document | change)
    with pytest.raises(sk.StreamkitError, match=text):
        calibrate(spec, tmp_path, 1, truth=truth)


def test_data_of_another_kind_are_refused(spec, tmp_path):
    apocentres = {"kind": "apocentres", "leading": ["40 kpc", "1 kpc"]}
    truth = sk.load({**spec.document, "observable": apocentres})
    with pytest.raises(sk.StreamkitError, match="observable is of the kind 'apocentres', and that of the fit 'itself'"):
        calibrate(spec, tmp_path, 1, truth=truth)
    assert not list(tmp_path.iterdir())


def test_mock_data_for_another_method_keep_the_truth_of_their_own_host(spec, halo, tmp_path):
    assert not write_mocks(spec, tmp_path, 2, truth=halo)
    truths = read_truths(tmp_path, spec, halo)
    assert [truths[index].tolist() for index in (0, 1)] == [draw_mock(spec, halo, i)[0].tolist() for i in (0, 1)]


@pytest.mark.rendered
def test_the_command(spec, halo, tmp_path):
    (tmp_path / "fit.toml").write_text(spec.toml())
    (tmp_path / "true.toml").write_text(halo.toml())
    command = ["calibrate", str(tmp_path / "fit.toml"), "--truth", str(tmp_path / "true.toml"), "--draws", "2"]
    command += ["--truth-set", "potential.q=0.9", "--radii", "20", "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 0, done.output
    table = QTable.read(tmp_path / "out" / "calibration.ecsv")
    assert "mass_20_rank" in table.colnames
    assert table.meta["truth"]["potential"]["q"] == 0.9
    wrong = CliRunner().invoke(main, [*command[:-1], str(tmp_path / "no"), "--truth", str(tmp_path / "nothing.toml")])
    assert wrong.exit_code == 2
    assert "nothing.toml" in wrong.output
