"""The command `sensitivity`: curves against direct calls of the model, slopes against closed forms, what it refuses."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable
from commands import call, refused
from runfiles import RUN
from scipy.stats import norm

import streamkit as sk
from streamkit.cli.sensitivity import apart
from streamkit.errors import ComponentError
from streamkit.runfile import LogUniform, Normal, Prior, TruncatedNormal, Uniform
from streamkit.sample import Evaluation, Posterior
from streamkit.stream import Array, Data
from streamkit.study.sensitivity import PRODUCTS, Sensitivity, run_sensitivity
from streamkit.study.sensitivity.curves import Curve, prior_grid
from streamkit.study.sensitivity.figure import sensitivity_figure
from streamkit.study.sensitivity.runner import evaluate, fixed_point
from streamkit.study.sensitivity.tables import describe_sensitivity
from streamkit.units import datum_unit

HERE = ("--set=potential.v0=215", "--set=progenitor.mass=6.4e8")
FEW = ("--points=5", "--set=stripping.particles=300")


@pytest.mark.parametrize(
    ("prior", "low", "high"),
    [
        (Uniform(40, 400), 49, 391),
        (Normal(153, 2), 153 - 1.959964 * 2, 153 + 1.959964 * 2),
        (LogUniform(1e8, 1e10), 10**8.05, 10**9.95),
        (TruncatedNormal(0, 1, 0, np.inf), norm.ppf(0.5125), norm.ppf(0.9875)),
    ],
)
def test_a_grid_covers_the_central_95_percent_of_the_prior(prior: Prior, low: float, high: float) -> None:
    x = prior_grid(prior, 7)
    assert (x[0], x[-1]) == (pytest.approx(low, rel=1e-6), pytest.approx(high, rel=1e-6))
    steps = np.diff(np.log(x) if isinstance(prior, LogUniform) else x)
    assert steps == pytest.approx(steps[0])


def curve(prior: Prior, fixed: float, x: Array, y: Array, streams: Array | None = None) -> Curve:
    """A curve of one observable without noise."""
    mean = np.where((streams if streams is not None else np.ones(len(x)))[:, None] > 0, y[:, None], np.nan)
    number = np.ones(len(x), int) if streams is None else streams
    return Curve("a.b", "kpc", prior, fixed, x, mean, mean * np.nan, mean * 0, number, tuple(Counter() for _ in x))


def test_the_slope_of_a_parabola_is_its_derivative() -> None:
    """At x = 3 of 5 + 2 x + x^2 / 2 it is 5, whatever the points; one sd of the prior is 1.5."""
    x = np.array([-2.0, 1.6, 2.0, 3.0, 3.4, 4.4, 9.0])
    y = 5 + 2 * x + x**2 / 2
    y[[0, -1]] = 1e3  # beyond one sd: not used
    slope = curve(Normal(3, 1.5), 3.0, x, y).slope
    assert slope.sd == pytest.approx(1.5)
    assert slope.per_unit == pytest.approx([5.0])
    assert slope.per_sd == pytest.approx([7.5])
    assert slope.at == pytest.approx([15.5])
    assert slope.error == pytest.approx([0.0], abs=1e-9)


def test_the_slope_of_a_log_uniform_prior_is_that_in_the_logarithm() -> None:
    """y = 3 ln x: per unit 3 / x; one sd is half of 68.27 % of ln 100."""
    x = np.geomspace(1, 100, 21)
    slope = curve(LogUniform(1, 100), 10.0, x, 3 * np.log(x)).slope
    assert slope.sd == pytest.approx(0.5 * 0.682689 * np.log(100), rel=1e-5)
    assert slope.per_sd == pytest.approx([3 * slope.sd])
    assert slope.per_unit == pytest.approx([0.3])


def test_the_error_of_a_slope_comes_from_the_scatter_about_the_parabola() -> None:
    """Five points at z = -1, -1/2 .. 1 with residuals e (1, -4, 6, -4, 1): orthogonal to every parabola.

    The sum of their squares is 70 e^2, of 2 degrees of freedom, and sum z^2 = 2.5.
    """
    e, z = 0.1, np.linspace(-1, 1, 5)
    slope = curve(Uniform(0, 1), 0.5, 0.5 + z * 0.6826894921370859 / 2, 2 * z + e * np.array([1, -4, 6, -4, 1])).slope
    assert slope.per_sd == pytest.approx([2.0])
    assert slope.error == pytest.approx([np.sqrt(35 * e**2 / 2.5)])


@pytest.mark.parametrize(("good", "known"), [(3, True), (2, False)])
def test_a_slope_needs_three_points_with_a_value(good: int, known: bool) -> None:
    z = np.linspace(-1, 1, 5)
    streams = np.array([1] * good + [0] * (5 - good))
    slope = curve(Normal(0, 1), 0.0, z, 2 * z, streams).slope
    assert np.isfinite(slope.per_sd).all() == known
    if known:
        assert slope.per_sd == pytest.approx([2.0])


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> sk.Spec:
    path = tmp_path_factory.mktemp("spec") / "small.toml"
    path.write_text(RUN)
    return sk.load(path).with_values({"stripping.particles": 300})


@pytest.fixture(scope="module")
def found(small: sk.Spec) -> Sensitivity:
    return run_sensitivity(small, {"potential.v0": 215, "progenitor.mass": "6.4e8 Msun"}, points=5, seeds=2)


def test_every_point_is_a_direct_call_of_the_model(small: sk.Spec, found: Sensitivity) -> None:
    assert [c.name for c in found.curves] == ["potential.v0", "progenitor.mass"]
    for c in found.curves:
        assert c.fixed in c.x
        for k in (1, 3):
            theta = {"potential.v0": 215.0, "progenitor.mass": 6.4e8} | {c.name: float(c.x[k])}
            means = []
            for seed in (7, 8):
                model = sk.Model(small.with_values({"seed": seed}))
                _, prediction = model.observe(model.spec.bind(theta))
                assert prediction is not None
                means += [] if prediction.why_not else [prediction.mean]
                assert prediction.why_not in {"", *c.reasons[k]}
            assert c.streams[k] == len(means)
            if means:
                assert c.mean[k] == pytest.approx(np.mean(means, axis=0), rel=1e-12)
            if len(means) == 2:
                assert c.scatter[k] == pytest.approx(np.abs(means[1] - means[0]) / np.sqrt(2))


def test_all_curves_meet_at_the_fixed_point(found: Sensitivity) -> None:
    at = [c.mean[c.x == c.fixed][0] for c in found.curves]
    assert np.isfinite(at).all()
    assert np.array_equal(at[0], at[1])


def test_a_heavier_host_lowers_the_apocentres(found: Sensitivity) -> None:
    """The progenitor's velocity today is fixed: in a deeper potential it rises less far (Gibbons+ 2014, figure 8)."""
    slope = found.curves[0].slope
    assert slope.per_sd[0] < -5
    assert slope.per_sd[1] < -10


def test_the_picture_has_a_panel_for_each_pair_with_the_data_and_the_gaps(found: Sensitivity) -> None:
    figure = sensitivity_figure(found)
    figure.draw_without_rendering()
    panels = [axes for axes in figure.axes if axes.get_visible()]
    assert len(panels) == 3 * 2
    labels = [axes.get_ylabel() for axes in panels if axes.get_ylabel()]
    assert labels == ["leading [kpc]", "trailing [kpc]", "precession [deg]"]
    for i, axes in enumerate(panels):
        c = found.curves[i % 2]
        band = axes.patches[0].get_bbox()  # the datum and its error
        datum, error = found.data.values[i // 2], found.data.errors[i // 2]
        assert (band.y0, band.y1) == (pytest.approx(datum - error), pytest.approx(datum + error))
        crosses = next(line for line in axes.lines if line.get_marker() == "x")
        assert len(crosses.get_xdata()) == (c.streams == 0).sum()
    gaps = [(c.streams == 0).sum() for c in found.curves]
    assert panels[0].get_title() == f"{gaps[0]} of {len(found.curves[0].x)} without a value"


def test_it_writes_tables_and_a_picture(run_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = call("sensitivity", run_file, *HERE, *FEW, "--seeds=2", "-o", out)
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in out.iterdir()) == sorted(PRODUCTS)
    table = QTable.read(out / "sensitivity.ecsv")
    assert set(table["parameter"]) == {"potential.v0", "progenitor.mass"}
    assert table["trailing"].unit == u.kpc
    assert table["precession"].unit == u.deg
    assert table.meta["fixed"] == {"potential.v0": 215.0, "progenitor.mass": 6.4e8}
    assert table.meta["data"]["leading"] == [57.0, 1.0]
    assert table.meta["run_digest"] == sk.load(out / "sensitivity.toml").digest()
    empty = table["streams"] == 0
    assert np.array_equal(empty, np.isnan(table["leading"]))
    reasons = np.asarray(table["reason"].filled("") if hasattr(table["reason"], "filled") else table["reason"])
    assert all(("2 x " in reason or "1 x " in reason) for reason in reasons[empty])
    slopes = QTable.read(out / "slopes.ecsv")
    assert slopes["parameter"].tolist() == ["potential.v0", "progenitor.mass"]
    assert slopes["sd"][0] == pytest.approx(0.5 * 0.682689 * 40, rel=1e-5)  # uniform over 40 km/s
    assert slopes["leading_per_sd"].unit == u.kpc
    assert slopes["leading_slope"][0] * slopes["sd"][0] == pytest.approx(slopes["leading_per_sd"][0].value)
    assert slopes["trailing_pull"][0] == pytest.approx(slopes["trailing_per_sd"][0].value / 5)  # error 5 kpc
    assert slopes["without"][0] == (empty & (table["parameter"] == "potential.v0")).sum()
    for text in ("potential.v0", "215 km/s", "precession", f"{slopes['leading_pull'][0]:+.2f}"):
        assert text in result.stdout
    assert all(len(line) <= 100 for line in result.stdout.splitlines())


def test_fields_are_chosen_and_workers_do_not_change_the_numbers(run_file: Path, tmp_path: Path) -> None:
    made = []
    for workers in ("1", "2"):
        out = tmp_path / workers
        result = call(
            "sensitivity", run_file, *HERE, *FEW, "--fields=progenitor.mass", "--workers", workers, "-o", out, "-q"
        )
        assert result.exit_code == 0, result.output
        assert result.stdout == ""
        made.append((out / "sensitivity.ecsv").read_text())
    assert made[0] == made[1]
    assert set(QTable.read(made[0], format="ascii.ecsv")["parameter"]) == {"progenitor.mass"}


def test_a_number_moves_a_free_parameter_and_anything_else_changes_the_file(small: sk.Spec) -> None:
    given = {"potential.v0": "0.2 km/ms", "potential.rs": {"uniform": [10, 14]}, "progenitor.radius": 0.5}
    spec, point = apart(small, given)
    assert point == {"potential.v0": "0.2 km/ms"}
    assert spec.names == ("potential.v0", "potential.rs", "progenitor.mass")
    assert fixed_point(spec, point)["potential.v0"] == pytest.approx(200)


def test_an_interruption_keeps_the_parameters_that_are_finished(
    run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[object] = []

    def stopping(job: Any) -> Evaluation:
        calls.append(job)
        if len(calls) == 8:  # the fixed point, the five of the first parameter, and one of the second
            raise KeyboardInterrupt
        return evaluate(job)

    monkeypatch.setattr("streamkit.study.sensitivity.runner.evaluate", stopping)
    result = call("sensitivity", run_file, *HERE, *FEW, "-o", tmp_path / "out")
    assert result.exit_code == 130
    assert "interrupted; the tables hold the finished part" in result.stderr
    assert QTable.read(tmp_path / "out" / "slopes.ecsv")["parameter"].tolist() == ["potential.v0"]
    calls[:] = 6 * [None]
    result = call("sensitivity", run_file, *HERE, *FEW, "-o", tmp_path / "none")
    assert result.exit_code == 130
    assert "interrupted before the first parameter was finished" in result.stderr


def test_a_component_that_fails_somewhere_is_a_reason_there(small: sk.Spec, monkeypatch: pytest.MonkeyPatch) -> None:
    working = Posterior.evaluate

    def failing(self: Posterior, theta: Array) -> Evaluation:
        if theta[1] > 7e8:
            raise ComponentError("stripping mlcs failed: ValueError in here: why. Parameters: potential.v0 = 215")
        return working(self, theta)

    monkeypatch.setattr(Posterior, "evaluate", failing)
    (c,) = run_sensitivity(small, {"potential.v0": 215}, fields=["progenitor.mass"], points=5).curves
    failed = [dict(reasons) for x, reasons in zip(c.x, c.reasons, strict=True) if x > 7e8]
    assert failed == [{"stripping mlcs failed: ValueError in here: why": 1}] * len(failed)
    assert failed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fields=potential.v"], "'potential.v' is no free parameter. Did you mean 'potential.v0'? Free: potential"),
        (["--fields=potential.rs"], "parameter. To vary a fixed one, give it a prior: --set 'potential.rs={ uniform"),
        (["--fields=potential.v0,potential.v0"], "potential.v0: given twice"),
        (["--set=potential.v0=300"], "potential.v0: found 300, outside its prior, uniform(190, 230) km/s"),
        (["--set=potential.v0=3 kpc"], "potential.v0: expected a quantity in km/s"),
        (["--set=potential.v=3"], "there is no field 'potential.v'. Did you mean 'potential.v0'?"),
        (["--points=4"], "4 is not in the range x>=5"),
        ([f"--set=progenitor.{name}=0" for name in ("y", "z", "vy", "vz")],
         "no stream where the parameters are fixed: the progenitor moves on a line"),
        (["--set=potential.v0={ uniform = [1, 2, 3] }"], "potential.v0: found uniform = [1, 2, 3], expected"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(run_file: Path, tmp_path: Path, arguments: list[str], message: str) -> None:
    assert message in re.sub(r"\s+", " ", refused("sensitivity", run_file, *arguments))
    assert not list(tmp_path.glob("*-sensitivity/*"))


def test_a_run_file_without_priors_or_data_is_refused(run_file: Path) -> None:
    text = run_file.read_text()
    run_file.write_text(re.sub(r"= \{.*\}", "= 200", text))
    assert f"{run_file}: no field has a prior" in refused("sensitivity", run_file)
    run_file.write_text(text.partition("[observable]")[0])
    assert f"{run_file}: observable: there is none" in refused("sensitivity", run_file)


def test_the_products_of_another_one_are_not_replaced(run_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "small-sensitivity"
    out.mkdir()
    (out / "slopes.ecsv").write_text("mine")
    assert "holds a sensitivity already (slopes.ecsv). --force replaces it" in refused("sensitivity", run_file)
    assert (out / "slopes.ecsv").read_text() == "mine"


def test_units_are_those_of_the_data(small: sk.Spec) -> None:
    observable = small.sections.streams["stream"].observables["observable"]
    assert {name: datum_unit(field) for name, field in observable.cls.model_fields.items()} == {
        "leading": "kpc", "trailing": "kpc", "precession": "deg", "recent_debris": "", "coverage": "", "phase": "",
    }  # fmt: skip


def test_of_many_data_the_rms_of_every_column_is_drawn(found: Sensitivity) -> None:
    """Twelve data of two columns: those of the curves at hand, four times over."""
    names = tuple(f"{column} at {i}" for column in ("phi2", "distance") for i in range(6))
    values, errors = np.tile(found.data.values, 4), np.tile(found.data.errors, 4)

    def longer(c: Curve) -> Curve:
        return replace(c, mean=np.tile(c.mean, 4), scatter=np.tile(c.scatter, 4), noise=np.tile(c.noise, 4))

    curves = tuple(map(longer, found.curves))
    many = replace(found, names=names, units=("",) * 12, data=Data(values, errors), curves=curves)
    panels = [axes for axes in sensitivity_figure(many).axes if axes.get_visible()]
    assert len(panels) == 2 * 2
    assert [axes.get_ylabel().split("\n")[0] for axes in panels if axes.get_ylabel()] == ["phi2", "distance"]
    expected = np.sqrt(np.mean(((found.curves[0].mean - found.data.values) / found.data.errors) ** 2, axis=1))
    line = next(line for line in panels[0].lines if line.get_marker() == "o")
    assert line.get_ydata() == pytest.approx(expected, nan_ok=True)
    slope = curves[0].slope.per_sd[:6] / errors[:6]
    said = describe_sensitivity(many)
    assert f"{np.sqrt(np.mean(slope**2)):.2f}" in said
    assert "phi2 at 0" not in said
