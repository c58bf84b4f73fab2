"""A stream's likelihood as a function of the host: its file, its place in a run file, its domain."""

import copy

import numpy as np
import pytest
from astropy.table import Table
from commands import call, refused
from scipy.stats import norm

import streamkit as sk
from streamkit.builtin.data.host_likelihood import EXAMPLE, HostLikelihood
from streamkit.fit import write_host_likelihoods
from streamkit.fit.judge.verdicts import overall

CENTRE, SD = np.log([225.0, 15.0]), np.array([0.05, 0.2])  # of the example: a Gaussian in closed form, out to 6 sd
HOST = {"kind": "tf", "v0": {"uniform": [150, 350]}, "rs": {"uniform": [5, 50]}, "alpha": 0.5}


def document(table=EXAMPLE, **changes):
    data = {"s": {"kind": "host_likelihood", "table": str(table)}}
    sampler = {"walkers": 16, "steps": 200}
    return {"potential": copy.deepcopy(HOST) | changes, "data": data, "sampler": sampler}


def changed(tmp_path, **meta):
    """The example with other notes."""
    table = Table.read(EXAMPLE, format="ascii.ecsv")
    table.meta.update(meta)
    table.write(tmp_path / "other.ecsv", format="ascii.ecsv")
    return tmp_path / "other.ecsv"


def test_the_likelihood_is_that_of_the_closed_form():
    posterior = sk.Posterior(document())
    for v0, rs in [(225.0, 15.0), (240.0, 12.0), (200.0, 20.0), (225.0, 30.0)]:
        x = (np.log([v0, rs]) - CENTRE) / SD
        found = posterior.evaluate(np.array([v0, rs]))
        assert found.ln_likelihood == pytest.approx(-0.5 * x @ x, abs=0.01)
        np.testing.assert_allclose(found.mean, np.log([v0, rs]))


def test_a_fixed_number_of_the_host_is_read_too():
    posterior = sk.Posterior(document(rs="20 kpc"))
    x = (np.log([230.0, 20.0]) - CENTRE) / SD
    assert posterior.evaluate(np.array([230.0])).ln_likelihood == pytest.approx(-0.5 * x @ x, abs=0.01)


def test_hosts_outside_the_domain_are_rejected_with_a_reason():
    posterior = sk.Posterior(document())
    v0 = float(np.exp(CENTRE[0] + 5.9 * SD[0]))
    assert np.isfinite(posterior.evaluate(np.array([v0, 15.0])).lnp)
    beyond = posterior.evaluate(np.array([float(np.exp(CENTRE[0] + 6.1 * SD[0])), 15.0]))
    assert beyond.lnp == -np.inf
    assert beyond.reason == "data.s: the host is outside the domain of the likelihood of example"


@pytest.mark.parametrize(("missing", "inside"), [(1, True), (6, False)])
def test_one_host_without_a_likelihood_is_bridged_and_several_are_a_hole(tmp_path, missing, inside):
    table = Table.read(EXAMPLE, format="ascii.ecsv")
    x = (np.log(np.array([table[name] for name in table.colnames[:2]]).T) - CENTRE) / SD
    middle = np.array([1.0, -1.0])
    gone = np.argsort(np.sum((x - middle) ** 2, axis=1))[:missing]
    for column in ("ln_likelihood", "error"):
        table[column][gone] = np.nan
    table.write(tmp_path / "holed.ecsv", format="ascii.ecsv")
    found = sk.Posterior(document(tmp_path / "holed.ecsv")).evaluate(np.exp(CENTRE + SD * middle))
    assert np.isfinite(found.lnp) == inside
    if inside:
        assert found.ln_likelihood == pytest.approx(-0.5 * middle @ middle, abs=0.02)


def test_many_hosts_at_once_have_the_likelihoods_of_each():
    data = HostLikelihood(**HostLikelihood.example)
    y = CENTRE + SD * np.random.default_rng(1).normal(size=(50, 2))
    names = ("potential.v0", "potential.rs")
    many = data.ln_likelihood(sk.Prediction(names, y, np.zeros_like(y)), True)
    each = [data.ln_likelihood(sk.Prediction(names, one, np.zeros(2)), True) for one in y]
    np.testing.assert_allclose(many, each, atol=1e-9)
    far = CENTRE + SD * np.array([[8.0, 0.0], [20.0, 0.0]])
    found = data.ln_likelihood(sk.Prediction(names, far, np.zeros_like(far)), True)
    np.testing.assert_allclose(found, -0.5 * np.array([8.0, 20.0]) ** 2, atol=0.1)  # beyond it falls on


def test_residuals_are_those_of_the_stream_alone():
    data = HostLikelihood(**HostLikelihood.example)
    y = CENTRE + SD * np.array([1.5, -2.0])
    found = data.residuals(sk.Prediction(("v0", "rs"), y, np.zeros(2)), False)
    np.testing.assert_allclose(found, [-1.5, 2.0], atol=1e-4)


@pytest.mark.parametrize(
    ("host", "message"),
    [
        ({"kind": "nfw", "mass": 1e12, "rs": 20},
         "data.s: the host_likelihood reads potential.v0, and the host has no such number."),
        ({"halo": HOST}, "reads potential.v0, and the host has no such number. Did you mean 'potential.halo.v0'?"),
    ],
)  # fmt: skip
def test_a_host_without_the_numbers_is_refused(host, message):
    with pytest.raises(sk.SpecError) as error:
        sk.load(document() | {"potential": host})
    assert message in str(error.value)


def test_another_host_than_that_of_the_file_is_refused(tmp_path):
    table = changed(tmp_path, assumes={"potential.kind": "tf", "potential.alpha": 0.5, "sun.r0": "8.0 kpc"})
    sk.load(document(table))
    for change, message in [
        ({"potential": HOST | {"alpha": 0.6}},
         "data.s: the host_likelihood assumes potential.alpha = 0.5; found 0.6"),
        ({"potential": HOST | {"alpha": {"uniform": [0, 1]}}}, "assumes potential.alpha = 0.5; found {"),
        ({"sun": {"r0": "8.2 kpc"}}, 'assumes sun.r0 = "8.0 kpc"; found "8.2 kpc"'),
    ]:  # fmt: skip
        with pytest.raises(sk.SpecError) as error:
            sk.load(document(table) | change)
        assert message in str(error.value)


def test_a_host_with_another_part_is_refused(tmp_path):
    table = Table.read(EXAMPLE, format="ascii.ecsv")
    table.rename_columns(["potential.v0", "potential.rs"], ["potential.halo.v0", "potential.halo.rs"])
    table.meta.update(
        logarithms=["potential.halo.v0", "potential.halo.rs"], assumes={"potential.halo.kind": "tf"}
    )
    table.write(tmp_path / "halo.ecsv", format="ascii.ecsv")
    one = document(tmp_path / "halo.ecsv") | {"potential": {"halo": HOST}}
    sk.load(one)
    bulge = {"kind": "hernquist", "mass": 1e10, "a": 0.6}
    with pytest.raises(sk.SpecError, match=r"assumes a host without \[potential\.bulge\]"):
        sk.load(one | {"potential": {"halo": HOST, "bulge": bulge}})


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda text: text.replace("host likelihood 1", "host likelihood 9"), "expected 'host likelihood 1'"),
        (lambda text: "a,b\n1,2\n", "no table in the format ECSV"),
        (lambda text: text.replace("- {reach: 6.0}\n", "- {other: 6.0}\n").replace("# - {other", "# - {other"),
         "it is damaged (KeyError: 'reach')"),
        (lambda text: text[: text.index("\n", text.index("166.6"))] + "\n", "it is damaged"),
    ],
)  # fmt: skip
def test_another_file_is_refused(tmp_path, spoil, message):
    path = tmp_path / "table.ecsv"
    path.write_text(spoil(EXAMPLE.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(sk.SpecError) as error:
        sk.load(document(path))
    assert message in str(error.value)
    assert "data.s.table" in str(error.value) or "data.s" in str(error.value)


@pytest.mark.parametrize("command", [["stream", "RUN", "-o", "stream.ecsv"], ["check", "RUN", "--stream", "gd1"]])
def test_what_needs_a_stream_says_that_there_is_none(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "RUN").write_text(sk.load(document()).toml(), encoding="utf-8")
    assert "there is no stream: the run file has data on the host alone" in refused(*command)


@pytest.mark.parametrize("command", ["stream", "host"])
def test_the_host_is_shown_without_a_stream(tmp_path, command):
    (tmp_path / "run.toml").write_text(sk.load(document()).toml(), encoding="utf-8")
    result = call(command, tmp_path / "run.toml")
    assert result.exit_code == 0
    assert ("data s (host_likelihood)" if command == "stream" else "M [Msun]") in result.stdout


def is_the_gaussian(results):
    """The prior is flat in v0 and rs: their logarithms have the mean of the file plus its variance."""
    for name, centre, sd in zip(("potential.v0", "potential.rs"), CENTRE, SD, strict=True):
        found = np.log(results[name])
        assert np.mean(found) == pytest.approx(centre + sd**2, abs=0.15 * sd)
        assert np.std(found) == pytest.approx(sd, rel=0.12)


def test_a_fit_without_a_stream_gives_the_gaussian(tmp_path):
    results = sk.run(document(), out=tmp_path / "fit", workers=1, progress=False, products=False)
    is_the_gaussian(results)
    assert overall(results.verdicts)[0] != "do not use"
    assert results.fit.at_edge == {"data.s": 0.0}
    with pytest.raises(sk.StreamkitError, match="the run has no stream: its run file has data on the host alone"):
        list(write_host_likelihoods(tmp_path / "fit", tmp_path))


def test_a_posterior_that_the_domain_cuts_is_not_to_be_used(tmp_path):
    """The Gaussian is cut at +0.5 sd; the edge begins at +0.25 sd."""
    table = changed(tmp_path, high=[CENTRE[0] + 0.5 * SD[0], None])
    shorter = document(table) | {"sampler": {"walkers": 16, "steps": 150}}
    results = sk.run(shorter, workers=1, progress=False)
    share = 1 - norm.cdf(0.25) / norm.cdf(0.5)
    assert results.fit.at_edge == {"data.s": pytest.approx(share, abs=0.06)}
    assert overall(results.verdicts)[0] == "do not use"
    (said,) = (each.sentence for each in results.verdicts if each.subject == "edge of the data's domain")
    assert said.startswith("The posterior reaches the edge of the hosts that data.s knows of")


@pytest.mark.slow
def test_the_emulator_fits_without_a_stream():
    spec = sk.load(document() | {"sampler": {"kind": "emulator", "starts": 1}})
    is_the_gaussian(sk.run(spec, workers=1, progress=False))
