"""The sampler on a Gaussian in closed form, and on a stream of 3 ms: resumed, killed, stopped, with its products."""

import re
import threading
import time

import numpy as np
import pytest
from streamkit_dynesty import Dynesty
from streamkit_dynesty.together import Together

import streamkit as sk
from streamkit.testing import check, killed

SMALL = {"live_points": 40, "evidence_left": 0.5, "together": 4}
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
    "sampler": {"kind": "dynesty", **SMALL},
}  # fmt: skip


def fit(out=None, document=RUN, **options):
    return sk.run(document, out=out, progress=False, products=False, components=[Dynesty], **options).weighted


def same(one, other):
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_array_equal(one.ln_weights, other.ln_weights)
    np.testing.assert_array_equal(one.blobs, other.blobs)
    assert one.ln_evidence == other.ln_evidence


@pytest.fixture(scope="module")
def whole():
    return fit()


@pytest.mark.slow
def test_it_samples_a_gaussian_and_finds_its_evidence():
    check(Dynesty)


@pytest.mark.slow
def test_workers_do_not_change_the_samples(whole, tmp_path):
    same(fit(tmp_path / "run", workers=2), whole)


def test_a_run_that_fails_on_the_way_goes_on_as_if_it_had_not(whole, tmp_path, monkeypatch, capsys):
    own, left = sk.Posterior.evaluate, iter(range(150))

    def evaluate(self, theta):
        if next(left, None) is None:
            raise sk.ComponentError("the toy fails")
        return own(self, theta)

    with monkeypatch.context() as patch:
        patch.setattr(sk.Posterior, "evaluate", evaluate)
        with pytest.raises(sk.ComponentError, match="the toy fails"):
            fit(tmp_path / "run")
    assert "Traceback" not in "".join(capsys.readouterr())  # dynesty's own
    same(fit(tmp_path / "run", resume=True), whole)


@pytest.mark.slow
def test_a_killed_run_goes_on_as_if_it_had_not(whole, tmp_path):
    out = tmp_path / "run"
    killed(lambda: fit(out), (out / "calls.journal").exists)
    assert (out / "calls.journal").exists()
    same(fit(out, resume=True), whole)


@pytest.mark.slow
def test_it_may_be_asked_for_more_when_it_goes_on(whole, tmp_path):
    fit(tmp_path / "run")
    longer = RUN | {"sampler": RUN["sampler"] | {"evidence_left": 0.3}}
    more = fit(tmp_path / "run", longer, resume=True)
    assert more.attributes["counts"]["calls"] > whole.attributes["counts"]["calls"]
    same(more, fit(document=longer))


@pytest.mark.slow
def test_it_says_how_far_it_is_and_when_it_may_end(monkeypatch, capsys):
    monkeypatch.setattr("streamkit.report.progress.EVERY", 0.0)
    sk.run(RUN, progress=True, products=False, components=[Dynesty])
    found, told = capsys.readouterr(), "streamkit: sampling: "
    lines = [line for line in found.err.splitlines() if told in line]
    assert re.search(r"sampling: \d+ calls after", lines[0])
    ends = [int(re.search(r"sampling: \d+ of (\d+) calls", line)[1]) for line in lines if " left" in line]
    assert ends[-1] == pytest.approx(int(re.search(r"sampling: (\d+)", lines[-1])[1]), rel=0.2)
    assert found.out == ""


def test_a_limit_of_calls_ends_it_and_says_so():
    found = fit(document=RUN | {"sampler": RUN["sampler"] | {"max_calls": 100}})
    assert found.missing
    assert found.attributes["counts"]["calls"] < 200


def test_its_paper_is_cited():
    spec = sk.load(RUN, components=[Dynesty])
    assert Dynesty.reference.split()[0] in Dynesty.bibtex
    assert spec.sampler.quick_settings(11)["live_points"] <= spec.sampler.live_points


def test_calls_of_walks_are_made_together():
    """Sums of three calls each, whose answers are known; never more than four points at a time."""
    asked = []

    def evaluate(points):
        asked.append(len(points))
        return points[:, 0] ** 2

    pool = Together(evaluate, 4)

    def walk(start):
        return sum(pool.ln_likelihood(np.array([start + i])) for i in range(3))

    found = pool.map(walk, range(10))
    assert found == [sum((start + i) ** 2 for i in range(3)) for start in range(10)]
    assert max(asked) == 4
    assert sum(asked) == 30
    assert pool.ln_likelihood(np.array([3.0])) == 9.0


@pytest.mark.timeout(60)
@pytest.mark.parametrize("where", ["evaluate", "walk", "walk, while the others wait"])
def test_a_fault_ends_all_walks(where):
    def evaluate(points):
        if where == "evaluate":
            raise KeyError("here")
        return points[:, 0]

    pool = Together(evaluate, 3)

    def walk(start):
        if where.startswith("walk") and start == 5:
            time.sleep(0.2 * where.endswith("wait"))
            raise KeyError("here")
        return pool.ln_likelihood(np.array([float(start)]))

    with pytest.raises(KeyError, match="here"):
        pool.map(walk, range(8))
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("walk")]
