"""Several streams in one host, several observables for one stream: sums, names, seeds, and every command."""

import copy
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from runfiles import APOCENTRES, FIT, error_of, with_entry

import streamkit as sk
from streamkit.cli.main import main
from streamkit.runfile import stream_seed, to_toml
from streamkit.study.sensitivity import run_sensitivity

OWN = ("progenitor", "stripping", "observable")
PAIR = {key: value for key, value in copy.deepcopy(APOCENTRES).items() if key not in OWN} | {
    "stream": {
        "near": {key: copy.deepcopy(APOCENTRES[key]) for key in OWN},
        "far": {key: copy.deepcopy(APOCENTRES[key]) for key in OWN},
    }
}
PAIR["stream"]["far"]["progenitor"] |= {"distance": 25.6, "v_los": {"uniform": [145, 155]}}
PAIR["stream"]["far"]["observable"] = {
    "depth": {"kind": "apocentres", "leading": [52, 5]},
    "angle": {"kind": "apocentres", "precession": [100, 8], "recent_debris": "literal"},
}


def alone(name):
    """The run file with one of the two streams, in the short form, with that stream's random numbers."""
    document = {key: value for key, value in PAIR.items() if key != "stream"} | PAIR["stream"][name]
    return sk.load(document | {"seed": stream_seed(PAIR["seed"], name)})


def pair(*path_and_value):
    """Return the run file of both with one entry replaced, or removed if the value is ..."""
    return with_entry(PAIR, *path_and_value)


@pytest.fixture(scope="module")
def spec():
    return sk.load(PAIR)


@pytest.fixture(scope="module")
def file(tmp_path_factory, spec) -> Path:
    path = tmp_path_factory.mktemp("several") / "pair.toml"
    path.write_text(spec.toml())
    return path


def command(*arguments):
    found = CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)
    assert found.exit_code == 0, found.output
    return found.output


def test_parameters_are_called_by_their_paths(spec):
    assert spec.streams == ("near", "far")
    assert set(spec.names) == {"potential.v0", "potential.alpha", "stream.far.progenitor.v_los"}
    assert sk.load(spec.document) == spec
    changed = spec.with_values({"stream.far.progenitor.distance": "29 kpc", "stream.near.stripping.sigma": 8})
    assert changed.document["stream"]["far"]["progenitor"]["distance"] == "29.0 kpc"
    assert changed.bind(stream="near").stripping.sigma == 8
    with pytest.raises(sk.SpecError, match=r"no stream is called 'fra'. Did you mean 'far'\? Streams: near, far"):
        spec.bind(stream="fra")
    with pytest.raises(sk.SpecError, match="no name of a stream"):
        sk.Model(spec).stream()


def test_the_resolved_file_is_read_back(spec, file):
    assert sk.load(file).document == spec.document
    assert "[stream.far.observable.depth]" in file.read_text()


def test_each_stream_is_the_one_it_would_be_alone_and_has_its_own_numbers(spec):
    theta = np.array([231.0, 0.33, 150.0])
    streams = sk.Model(spec).streams(theta)
    single = sk.Model(alone("far")).stream(dict(zip(alone("far").names, theta, strict=True)))
    np.testing.assert_array_equal(streams["far"].q, single.q)
    np.testing.assert_array_equal(sk.Model(spec).stream(theta, "far").q, single.q)
    assert len({stream_seed(3, name) for name in ("near", "far", "")}) == 3
    assert stream_seed(3, "") == 3


def test_the_log_likelihoods_add_up_exactly(spec):
    theta = np.array([231.0, 0.33, 150.0])
    both, near, far = sk.Posterior(spec), sk.Posterior(alone("near")), sk.Posterior(alone("far"))
    joint, first, second = both.evaluate(theta), near.evaluate(theta[:2]), far.evaluate(theta)
    assert np.isfinite(joint.lnp)
    assert joint.ln_likelihood == first.ln_likelihood + second.ln_likelihood
    np.testing.assert_array_equal(joint.mean, np.concatenate([first.mean, second.mean]))
    found = both.observe(theta).prediction
    assert found.names[0] == "near.leading"
    assert {"far.depth.leading", "far.angle.precession"} < set(found.names)
    # the two observables of the second stream are those of two run files with one each
    parts = [alone("far").document | {"observable": each} for each in PAIR["stream"]["far"]["observable"].values()]
    singles = [sk.Posterior(sk.load(part)).evaluate(theta).ln_likelihood for part in parts]
    assert second.ln_likelihood == sum(singles)


def test_a_stream_that_cannot_be_measured_is_named(spec):
    short = sk.load(pair("stream", "far", "progenitor", "lookback", 0.05))
    found = sk.Posterior(short).evaluate(short.centre())
    assert found.lnp == -np.inf
    assert found.reason.startswith("far: ")
    assert len(found.mean) == 9


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (pair("stream", "near", "progenitor", ...), "the section [stream.near.progenitor] is missing"),
        (pair("stream", "ne.ar", PAIR["stream"]["near"]), "the name of a stream may not contain a dot"),
        (pair("stream", "stream", PAIR["stream"]["near"]), "may not be called 'stream'"),
        (pair("stream", "progenitor", {"kind": "plummer"}), "expected [stream.NAME.progenitor]"),
        (pair("stream", "near", 7), "stream.near: found 7, expected sections such as [stream.near.progenitor]"),
        (pair("stream", "near", "progenitor", 7), "stream.near.progenitor: found 7, expected a section"),
        (pair("stream", "near", "observabel", {}), "Did you mean 'observable'?"),
        (pair("observable", {"kind": "apocentres"}), "observable: found beside the named streams near, far"),
        (pair("progenitor", APOCENTRES["progenitor"]), "progenitor: found beside the named streams near, far"),
        (
            pair("stream", "far", "observable", "kind", "apocentres"),
            "found a kind of its own and the named observables",
        ),
        (pair("stream", "far", "observable", "depth", "kind", "apocenters"), "Did you mean 'apocentres'?"),
        (pair("stream", "far", "observable", "a.b", {"kind": "apocentres"}), "name of an observable may not contain"),
        (pair("stream", "near", "stripping", "sigmaa", 3), "Did you mean 'sigma'?"),
    ],
)
def test_what_is_wrong_is_said_where_it_is(document, words):
    found = error_of(document)
    assert words in found
    assert len(found.splitlines()) == 1


def test_every_stream_of_a_fit_needs_an_observable():
    with pytest.raises(sk.SpecError, match=r"^run mapping: stream.near.observable: there is none, .* for every stream"):
        sk.Posterior(sk.load(pair("stream", "near", "observable", ...)))


def test_bad_input_has_status_2(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(to_toml(pair("stream", "near", "progenitor", ...)))
    found = CliRunner().invoke(main, ["check", str(path)])
    assert found.exit_code == 2


def test_stream_writes_and_draws_each(file, tmp_path):
    said = command("stream", file, "-o", tmp_path / "s.ecsv", "--plot", tmp_path / "s.png")
    assert {path.name for path in tmp_path.iterdir()} == {"s-near.ecsv", "s-far.ecsv", "s-near.png", "s-far.png"}
    assert "stream near" in said
    assert "depth.leading" in said


def test_check_looks_at_each(file):
    said = command("check", file, "--draws", "2")
    assert "stream near, at the prior's centre" in said
    assert "stream far, at the prior's centre" in said
    assert "depth.leading" in said


def test_sensitivity_knows_the_units_of_all(file, tmp_path):

    found = run_sensitivity(sk.load(file), fields=["stream.far.progenitor.v_los"], points=5)
    units = dict(zip(found.names, found.units, strict=True))
    assert (units["near.leading"], units["far.angle.precession"]) == ("kpc", "deg")
    slopes = dict(zip(found.names, found.curves[0].slope.per_sd, strict=True))
    assert abs(slopes["near.leading"]) < 1e-9  # the other stream's velocity
    assert abs(slopes["far.depth.leading"]) > 0.1


@pytest.mark.slow
def test_ablate_takes_a_stream_by_name(file, tmp_path):
    vary = "stream.far.stripping.kind=mlcs,streakline"
    said = command("ablate", file, "--vary", vary, "--stream", "far", "-o", tmp_path / "out")
    assert "streakline" in said
    missing = CliRunner().invoke(main, ["ablate", str(file), "--vary", vary, "-o", str(tmp_path / "no")])
    assert missing.exit_code == 2
    assert "Streams: near, far" in missing.output


def test_a_fit_of_several_streams_is_reported_with_a_picture_of_each(tmp_path):
    out, document = tmp_path / "out", {key: value for key, value in FIT.items() if key not in OWN}
    streams = {name: {key: copy.deepcopy(FIT[key]) for key in OWN} for name in ("near", "far")}
    streams["far"]["progenitor"]["v_los"] = {"uniform": [145, 155]}
    distance = streams["far"]["observable"].pop("distance")
    streams["far"]["observable"] = {
        "depth": {key: FIT["observable"][key] for key in ("kind", "kernel", "frame")} | {"distance": distance},
        "speed": streams["far"]["observable"],
    }
    document["stream"] = streams
    results = sk.run(document, out, progress=False)
    assert {"best_stream_near.png", "best_stream_far.png", "summary.ecsv"} <= {path.name for path in out.iterdir()}
    assert not results.failed
    assert set(results.best_observation.streams) == {"near", "far"}
    again = sk.run(document, out, steps=6, resume=True, progress=False, products=False)
    assert len(again.chain) == 6


@pytest.mark.slow
def test_two_mock_streams_recover_the_host_better_than_either():
    """On a grid over both parameters of the host, with data from a stream of other random numbers."""
    document = pair("stream", "far", "progenitor", "v_los", 150)
    document["stream"]["far"]["observable"] = copy.deepcopy(APOCENTRES["observable"])
    truth = np.array([230.0, 0.35])
    for name, stream in sk.Posterior(sk.load(document | {"seed": 99})).observe(truth).predictions.items():
        errors = zip(("leading", "trailing", "precession"), stream.mean, (5, 15, 8), strict=True)
        document["stream"][name]["observable"] |= {datum: [float(mean), error] for datum, mean, error in errors}
    posterior = sk.Posterior(sk.load(document))
    grid = np.stack(np.meshgrid(np.linspace(216, 244, 8), np.linspace(0.26, 0.44, 8)), axis=-1).reshape(-1, 2)
    found = [posterior.evaluate(theta) for theta in grid]
    mean, data = np.array([each.mean for each in found]), posterior.data
    chi2 = ((mean - data.values) / data.errors) ** 2
    volume = {}
    for name, part in {"near": slice(0, 3), "far": slice(3, 6), "both": slice(0, 6)}.items():
        ln = np.where(np.isfinite(mean).all(axis=1), -0.5 * chi2[:, part].sum(axis=1), -np.inf)
        weight = np.exp(ln - ln.max())
        volume[name] = np.sqrt(np.linalg.det(np.cov(grid.T, aweights=weight)))
        centre = np.average(grid, axis=0, weights=weight)
        assert (np.abs(centre - truth) < 2 * np.sqrt(np.diag(np.cov(grid.T, aweights=weight)))).all()
    assert volume["both"] < 0.9 * min(volume["near"], volume["far"])
