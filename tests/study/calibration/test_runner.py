"""The calibration study: ranks against closed forms, draws that survive, products."""

import errno
import os
import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.table import QTable
from click.testing import CliRunner
from importance import Importance
from itself import ERROR, PLUGIN, WIDTH, exact_rank, itself
from runfiles import changed
from scipy.stats import norm

import streamkit as sk
from streamkit.cli.main import main
from streamkit.errors import Interrupted
from streamkit.study.calibration import Calibration, Draw, calibrate, calibration_products, write_mocks
from streamkit.study.calibration.draw import make_draw
from streamkit.study.calibration.runner import DRAWS, read_draws


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    return itself(tmp_path_factory.mktemp("plugin"))


@pytest.fixture(scope="module")
def short(spec):
    return spec.with_values({"sampler.steps": 10})


@pytest.fixture(scope="module")
def drawn(spec):
    """Return the draws by their number, each made once."""
    return cache(lambda index: make_draw(spec, index))


@pytest.fixture(scope="module")
def drawn_once(short):
    """Return a draw whose fit has few steps."""
    return make_draw(short, 0)


@pytest.fixture(scope="module")
def weighted(spec):
    """Return a draw whose sampler has weights."""
    settings = {"kind": "importance", "draws": 1000}
    return make_draw(sk.load(spec.document | {"sampler": settings}, components=[Importance]), 0)


@pytest.mark.slow  # the exact rank of weighted samples is below
@pytest.mark.parametrize("index", [0, 1, 2])
def test_the_rank_is_that_of_the_exact_posterior(spec, drawn, index):
    """Prior and datum are Gaussian with one width, so the posterior's mean is halfway, its width 1/sqrt2 of theirs."""
    draw = drawn(index)
    rng = np.random.default_rng([spec.seed, 7, index])
    rng.integers(1 << 31)
    truth = float(spec.priors[0].sample(rng, 1)[0])
    datum = rng.normal(truth, ERROR)
    assert draw.truth == (pytest.approx(truth),)
    assert draw.ranks[0] == pytest.approx(exact_rank(truth, datum), abs=0.15)
    assert draw.host_ranks[1] == pytest.approx(draw.ranks[0], abs=1e-12)  # the mass rises with v0


def test_a_sampler_with_weighted_samples_is_calibrated_too(spec, weighted, drawn_once):
    """It has no R-hat: its draws count by their effective number."""
    draw = weighted
    assert draw.truth == drawn_once.truth
    rng = np.random.default_rng([spec.seed, 7, 0])
    rng.integers(1 << 31)
    truth = float(spec.priors[0].sample(rng, 1)[0])
    exact = exact_rank(truth, rng.normal(truth, ERROR))
    assert draw.ranks[0] == pytest.approx(exact, abs=0.1)
    assert np.isnan(draw.r_hat)
    assert 200 < draw.ess < 1000
    assert Draw.of_line(draw.line()).ess == draw.ess


def test_draws_are_kept_and_only_the_missing_ones_made(short, tmp_path):
    out, seen = tmp_path / "out", []
    first = calibrate(short, out, 2, done=lambda: seen.append(1))
    lines = (out / DRAWS).read_text()
    (out / DRAWS).write_text(lines + '{"index": 9, "tru')
    again = calibrate(short, out, 3, resume=True)
    assert again.draws[:2] == first.draws
    assert [draw.index for draw in again.draws] == [0, 1, 2]
    assert read_draws(out / DRAWS, short) == dict(enumerate(again.draws))
    assert len(seen) == 2


def test_draws_of_another_run_file_are_refused(short, tmp_path):
    calibrate(short, tmp_path / "out", 1)
    with pytest.raises(sk.StreamkitError, match="belong to another run file"):
        calibrate(short.with_values({"stripping.sigma": 5.0}), tmp_path / "out", 1, resume=True)


def test_an_interruption_before_the_first_draw_is_one(short, tmp_path, monkeypatch):
    for module, study in (("runner", calibrate), ("mocks", write_mocks)):
        monkeypatch.setattr(f"streamkit.study.calibration.{module}.run_jobs", lambda *_: ({}, "interrupted"))
        with pytest.raises(Interrupted, match="interrupted before the first draw was finished"):
            study(short, tmp_path / module, 1)


def test_a_full_disk_is_told_with_the_file(short, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("streamkit.study.calibration.runner.make_draw", lambda *_: SimpleNamespace(line=lambda: ""))
    monkeypatch.setattr("streamkit.study.calibration.runner.os.write", full)
    with pytest.raises(sk.StreamkitError, match=r"draws\.jsonl: draw 0 cannot be written \(No space left on device\)"):
        calibrate(short, tmp_path / "out", 1)
    assert not (tmp_path / "out" / DRAWS).exists()  # the next try needs no --force


def uniform(spec, n):
    ranks = (np.arange(n) + 0.5) / n
    return Calibration(
        spec, tuple(Draw(i, (1.0,), (r,), (1.0,) * 3, (r,) * 3, 1.0, 1e3, 10, i % 4 > 0) for i, r in enumerate(ranks))
    )


def test_coverage_of_uniform_ranks(spec):
    result = uniform(spec, 200)
    for probability in (0.5, 0.68, 0.95):
        assert result.coverage(probability) == pytest.approx([probability] * 4, abs=0.005)
    products = calibration_products(result)
    assert "68%" in products.text
    assert products.pictures["calibration.png"]().axes[0].get_title()
    assert not calibration_products(uniform(spec, 1)).pictures  # as after an interruption


def test_it_tells_how_many_fits_converged(spec):
    products = calibration_products(uniform(spec, 200))
    text = " ".join(products.text.split())
    assert "150 of 200 fits have converged by the rule of emcee." in text
    assert "1000 effective samples of 10 streams" in text
    assert products.tables["calibration.ecsv"]["converged"].sum() == 150
    assert products.header["converged"] == 150


def test_what_the_pages_say_stands_beside_whether_the_truth_was_missed(spec):
    """By Bonferroni for four quantities a rank must be within 0.00625 of an end: two of 200 even ones are."""
    even = uniform(spec, 200)
    assert np.flatnonzero(even.missed).tolist() == [0, 199]
    bad = ("goodness of fit", "do not use")
    said = [(bad,) if draw.index in (0, 7, 8) else () for draw in even.draws]
    draws = tuple(replace(draw, said=each) for draw, each in zip(even.draws, said, strict=True))
    products = calibration_products(Calibration(spec, draws))
    assert [tuple(row) for row in products.tables["checks.ecsv"].iterrows()] == [(*bad, 1, 2)]
    assert re.search(r"check of the page +says +in 2 that miss the truth +in 198 others", products.text)
    assert re.search(r"goodness of fit +do not use +1 +2\n", products.text)
    assert "every check of every fit is fine" in calibration_products(even).text
    assert dict(Draw.of_line(draws[7].line()).said) == dict([bad])


def test_masses_with_the_ranks_of_a_parameter_have_no_picture_of_their_own(spec):
    ranks = np.array([[0.1, 0.1, 0.1, 0.3], [0.8, 0.8, 0.8, 0.6]])
    draws = (Draw(i, (1.0,), (r[0],), (1.0,) * 3, tuple(r[1:]), 1.0, 1e3, 10, True) for i, r in enumerate(ranks))
    figure = calibration_products(Calibration(spec, tuple(draws))).pictures["calibration.png"]()
    shown = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(shown) == 2
    assert "200" in shown[1]


def test_a_draw_tells_whether_its_fit_converged(drawn_once, weighted):
    """Ten steps are never enough; a sampler with weights says it by its own rule."""
    assert not drawn_once.converged
    assert "do not use" in dict(drawn_once.said).values()
    assert weighted.converged
    assert Draw.of_line(weighted.line()).converged is True


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1])
def test_data_of_another_truth_show_its_bias(spec, drawn, index):
    """The truth's speed is read 1.5 errors too high, so the exact posterior is 0.75 errors too high."""
    high = spec.with_values({"observable.bias": 1.5 * ERROR})
    result, other = drawn(index), make_draw(spec, index, high)
    assert result.truth == other.truth
    assert result.host == other.host
    moved = norm.ppf(result.ranks[0]) - norm.ppf(other.ranks[0])
    assert moved == pytest.approx(0.75 * ERROR / WIDTH, abs=0.4)


def test_draws_of_another_truth_are_refused(short, tmp_path):
    other = short.with_values({"observable.bias": 1.0})
    calibrate(short, tmp_path / "out", 1, truth=other)
    with pytest.raises(sk.StreamkitError, match="belong to another run file"):
        calibrate(short, tmp_path / "out", 1, resume=True)
    again = calibrate(short, tmp_path / "out", 1, resume=True, truth=other)
    assert "bias" in str(calibration_products(again).header["truth"])


def test_an_observable_without_mock_data_says_so(spec, tmp_path):
    (tmp_path / "itself.py").write_text(PLUGIN.replace("def mock", "def mocked").replace('"itself"', '"other"'))
    other = sk.load(
        {
            **spec.document,
            "plugins": [str(tmp_path / "itself.py")],
            "observable": {"kind": "other", "speed": [200.0, 20.0]},
        }
    )
    with pytest.raises(sk.StreamkitError, match="makes no mock data"):
        make_draw(other, 0)


def test_apocentres_draw_around_what_they_predict():
    observable = sk.load(changed("observable", {"kind": "apocentres", "leading": [47.8, 0.5]})).bind().observable
    prediction = sk.Prediction(("leading", "trailing", "precession"), np.array([40.0, 60.0, 90.0]), np.zeros(3))
    drawn = [observable.mock(prediction, np.random.default_rng(i)) for i in range(400)]
    assert {tuple(fields) for fields in drawn} == {("leading",)}
    values = np.array([fields["leading"] for fields in drawn])
    assert values[:, 0].mean() == pytest.approx(40.0, abs=0.1)
    assert values[:, 0].std() == pytest.approx(0.5, rel=0.15)


@pytest.mark.rendered
def test_the_command(spec, tmp_path):
    (tmp_path / "run.toml").write_text(spec.toml())
    options = ["calibrate", str(tmp_path / "run.toml"), "-o", str(tmp_path / "out"), "--draws", "2"]
    done = CliRunner().invoke(main, [*options, "--set", "sampler.steps=5", "--truth-set", "stripping.sigma=5"])
    assert done.exit_code == 0, done.output
    assert "share of 2 draws" in done.output
    assert len(QTable.read(tmp_path / "out" / "calibration.ecsv")) == 2
    assert (tmp_path / "out" / "calibration.png").stat().st_size > 5000
    assert CliRunner().invoke(main, options).exit_code == 2
    wrong = CliRunner().invoke(main, [*options, "-f", "--truth-set", "stripping.kin=streakline"])
    assert wrong.exit_code == 2
    assert "Did you mean 'stripping.kind'" in " ".join(wrong.output.split())
