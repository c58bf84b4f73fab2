"""The sampler on a Gaussian in closed form, and on a stream of 3 ms: resumed, killed, stopped, with its products."""

import re

import numpy as np
import pytest
from streamkit_nautilus import Nautilus

import streamkit as sk
from streamkit.testing import check, killed

SMALL = {"live_points": 60, "effective_samples": 150, "networks": 1, "batch": 20}
RUN = {
    "seed": 3,
    "sun": {"v_circ": "host"},
    "potential": {"kind": "logarithmic_halo", "v0": {"uniform": [200, 240]}, "q": {"uniform": [0.7, 1.1]}},
    "progenitor": {
        "kind": "plummer", "mass": 2e4, "radius": 0.03, "frame": "GD1Koposov10", "phi1": -30, "phi2": 0.1,
        "distance": 8.2, "pm_phi1_cosphi2": -12.84, "pm_phi2": -2.65, "v_los": -76.6, "lookback": 0.2,
    },
    "stripping": {"kind": "mlcs", "particles": 100, "sigma": 1},
    "integrator": {"kind": "leapfrog", "step": 0.02},
    "observable": {
        "kind": "track", "frame": "GD1Koposov10", "kernel": 3,
        "phi2": {"phi1": [-36, -24], "phi2": [0, 0.5], "error": [0.3, 0.3]},
        "radial_velocity": {"phi1": [-36, -24], "radial_velocity": [-65, -100], "error": [10, 10]},
    },
    "sampler": {"kind": "nautilus", **SMALL},
}  # fmt: skip


def fit(out=None, document=RUN, **options):
    return sk.run(document, out=out, progress=False, products=False, components=[Nautilus], **options).weighted


def same(one, other):
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_array_equal(one.ln_weights, other.ln_weights)
    np.testing.assert_array_equal(one.blobs, other.blobs)
    assert one.ln_evidence == other.ln_evidence


def with_settings(document, **settings):
    return document | {"sampler": document["sampler"] | settings}


@pytest.fixture(
    scope="module",
    params=[
        pytest.param({"networks": 0, "live_points": 30, "effective_samples": 40}, id="few points"),
        pytest.param({"networks": 0}, id="", marks=pytest.mark.slow),
        pytest.param({"networks": 1}, id="with a network", marks=pytest.mark.slow),
    ],
)
def document(request):
    """The run file; training networks is most of the time, where there are any."""
    return with_settings(RUN, **request.param)


@pytest.fixture(scope="module")
def whole(document):
    return fit(document=document)


@pytest.mark.slow
@pytest.mark.parametrize("networks", [0, 1])
def test_it_samples_a_gaussian_and_finds_its_evidence(networks, monkeypatch):
    monkeypatch.setattr(Nautilus, "example", Nautilus.example | {"networks": networks})
    check(Nautilus)


@pytest.mark.slow
def test_workers_do_not_change_the_samples(whole, document, tmp_path):
    same(fit(tmp_path / "run", document, workers=2), whole)


@pytest.mark.slow  # dynesty's test of the same is fast
def test_a_run_that_fails_on_the_way_goes_on_as_if_it_had_not(whole, document, tmp_path, monkeypatch):
    own, left = sk.Posterior.evaluate, iter(range(150))

    def evaluate(self, theta):
        if next(left, None) is None:
            raise sk.ComponentError("the toy fails")
        return own(self, theta)

    with monkeypatch.context() as patch:
        patch.setattr(sk.Posterior, "evaluate", evaluate)
        with pytest.raises(sk.ComponentError, match="the toy fails"):
            fit(tmp_path / "run", document)
    same(fit(tmp_path / "run", document, resume=True), whole)


@pytest.mark.slow
def test_a_killed_run_goes_on_as_if_it_had_not(whole, document, tmp_path):
    out = tmp_path / "run"
    killed(lambda: fit(out, document), (out / "calls.journal").exists)
    assert (out / "calls.journal").exists()
    same(fit(out, document, resume=True), whole)


@pytest.mark.slow
def test_it_may_be_asked_for_more_when_it_goes_on(whole, document, tmp_path):
    fit(tmp_path / "run", document)
    longer = with_settings(document, effective_samples=400)
    more = fit(tmp_path / "run", longer, resume=True)
    assert more.attributes["counts"]["calls"] > whole.attributes["counts"]["calls"]
    same(more, fit(document=longer))


@pytest.mark.slow
def test_it_says_how_far_it_is_and_when_it_may_end(document, monkeypatch, capsys):
    monkeypatch.setattr("streamkit.report.progress.EVERY", 0.0)
    longer = with_settings(document, effective_samples=900)
    sk.run(longer, progress=True, products=False, components=[Nautilus])
    found, told = capsys.readouterr(), "streamkit: sampling: "
    lines = [line for line in found.err.splitlines() if told in line]
    assert re.search(r"sampling: \d+ calls after", lines[0])
    ends = [int(re.search(r"sampling: \d+ of (\d+) calls", line)[1]) for line in lines if " left" in line]
    assert ends[-1] == pytest.approx(int(re.search(r"sampling: (\d+)", lines[-1])[1]), rel=0.2)
    assert found.out == ""


def test_a_limit_of_calls_ends_it_and_says_so():
    found = fit(document=with_settings(RUN, max_calls=100))
    assert found.missing
    assert found.attributes["counts"]["calls"] < 200


def test_its_paper_is_cited():
    spec = sk.load(RUN, components=[Nautilus])
    assert Nautilus.reference.split()[0] in Nautilus.bibtex
    assert spec.sampler.quick_settings(11)["live_points"] <= spec.sampler.live_points


def test_one_parameter_is_too_few():
    one = RUN | {"potential": RUN["potential"] | {"q": 0.9}}
    with pytest.raises(sk.SpecError, match=r"sampler\.kind: nautilus needs 2 free parameters, found 1"):
        sk.load(one, components=[Nautilus])
