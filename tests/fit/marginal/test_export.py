"""Runs by the emulator as likelihoods of the host: from stored calls alone, of several streams and of one."""

from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table
from commands import call
from runfiles import FIT, several

import streamkit as sk
from streamkit.fit import host_likelihood_files, write_host_likelihoods
from streamkit.runfile import host_values
from streamkit.testing.contained import in_a_process

CURVE = {"curve": {"kind": "circular_velocity", "radius": 8.0, "v_c": [229, 7]}}


def spec_of(names, **sampler):
    document = several(*names, data=CURVE) | {"sampler": {"kind": "emulator", "starts": 1, "max_calls": 400, **sampler}}
    for name in names:
        document["stream"][name]["stripping"]["particles"] = 200
    return sk.load(document)


def note_of(path):
    return Table.read(path, format="ascii.ecsv").meta["note"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory):
    out = tmp_path_factory.mktemp("marginal") / "run"
    return out, sk.run(spec_of("ab"), out=out, workers=1, progress=False, products=False)


@pytest.mark.slow
def test_files_of_two_streams_give_their_joint_posterior(run, tmp_path: Path) -> None:
    out, joint = run
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    written = dict(write_host_likelihoods(out, tmp_path))
    assert [path.name for path in written] == host_likelihood_files(out) == ["a_host.ecsv", "b_host.ecsv"]
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before
    host = {key: joint.spec.document[key] for key in ("potential", "sun")}
    data = {name: {"kind": "host_likelihood", "table": str(tmp_path / f"{name}_host.ecsv")} for name in "ab"}
    spec = sk.load({**host, "data": CURVE | data, "sampler": {"walkers": 24, "steps": 1500}})
    assert host_values(spec.document) == host_values(joint.spec.document)
    product = sk.run(spec, workers=1, progress=False)
    for name in spec.names:
        sd = joint[name].std()
        assert product[name].mean() == pytest.approx(joint[name].mean(), abs=0.3 * sd), name
        assert product[name].std() == pytest.approx(sd, rel=0.3), name


@pytest.mark.slow
def test_the_same_directory_gives_the_same_files(run, tmp_path: Path) -> None:
    """With one process as with two, each of which writes one."""
    for name, workers in (("first", 1), ("second", 2)):
        (tmp_path / name).mkdir()
        list(write_host_likelihoods(run[0], tmp_path / name, workers=workers))
    for path in (tmp_path / "first").iterdir():
        assert path.read_bytes() == (tmp_path / "second" / path.name).read_bytes()


@pytest.mark.slow
def test_a_run_of_one_stream_gives_one_file_without_the_data_of_the_host(tmp_path: Path) -> None:
    """Its values are those of the stream's own data alone: the spread of the host is wider without the curve."""
    document = several("a", data=CURVE)
    stream = document.pop("stream")["a"]
    document |= stream | {"sampler": {"kind": "emulator", "starts": 1, "max_calls": 400}}
    document["stripping"]["particles"] = 200
    out = tmp_path / "one"
    results = sk.run(document, out=out, workers=1, progress=False, products=False)
    text = in_a_process(lambda: [call("export", str(out), "--host-likelihood", "-o", str(tmp_path)).stdout])[0]
    assert "stream_host.ecsv" in text
    assert results.note() in " ".join(text.split())
    assert note_of(tmp_path / "stream_host.ecsv") == results.note()
    spec = sk.load({
        "potential": results.spec.document["potential"], "sun": results.spec.document["sun"],
        "data": {"s": {"kind": "host_likelihood", "table": str(tmp_path / "stream_host.ecsv")}},
    })  # fmt: skip
    measured = spec.bind_all().data["s"]
    shared = [name for name in results.names if name.startswith("potential.")]
    assert list(measured.reads()) == shared
    assert np.all(measured.data()[1] > 0)


def test_a_run_by_another_sampler_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "chain"
    sk.run(FIT, out=out, steps=1, progress=False, products=False)
    with pytest.raises(sk.StreamkitError, match=r"no call of .* by the sampler emulator; it has the sampler emcee"):
        list(write_host_likelihoods(out, tmp_path))
