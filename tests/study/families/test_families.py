"""Hosts of several families: averages and weights in closed form, and the command on data of the host."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from astropy.table import QTable
from commands import call
from scipy.stats import norm
from shortened import take_few_steps

import streamkit as sk
from streamkit.errors import Interrupted
from streamkit.study.families import average, stacking_weights, weights_of
from streamkit.study.families.products import remedy
from streamkit.study.families.runner import Family

RUN = """
seed = 3
[potential.halo]
kind = "tf"
v0 = { uniform = ["150 km/s", "300 km/s"] }
rs = "12 kpc"
alpha = 0.45
[data.sun]
kind = "circular_velocity"
radius = "8 kpc"
v_c = ["229 km/s", "7 km/s"]
[sampler]
kind = "emulator"
starts = 1
"""
OTHER = """
[potential.halo]
kind = "tf"
v0 = { uniform = ["230 km/s", "500 km/s"] }
rs = "30 kpc"
alpha = 0.2
"""


def test_the_weights_are_ratios_of_evidences() -> None:
    weights, errors = weights_of(np.log([3.0, 1.0]) - 500.0, np.array([0.1, 0.0]), 1)
    assert weights == pytest.approx([0.75, 0.25])
    assert errors == pytest.approx(0.1 * 0.75 * 0.25 * np.ones(2), rel=0.1)  # w (1 - w) of an error of ln Z


def test_stacking_finds_the_best_mixture() -> None:
    """Two families and two streams, densities 1 and a, 1 and b: the sum of ln (1 - w + w a) is largest at this w."""
    a, b = 3.0, 0.2
    w = -(a + b - 2) / (2 * (a - 1) * (b - 1))
    ln_density = np.log([[1.0, a], [1.0, b]]) - 300.0
    weights, errors = stacking_weights(ln_density, 1)
    assert weights == pytest.approx([1 - w, w], abs=1e-6)
    assert (errors > 0).all()
    better = np.log([[1.0, 2.0], [1.0, 5.0]])  # one family that predicts all streams better gets all the weight
    assert stacking_weights(better, 1)[0] == pytest.approx([0, 1], abs=1e-6)


def test_stacking_predicts_streams_and_no_data_of_the_host() -> None:
    """Without a rotation curve the streams may leave the host undetermined."""
    table = QTable({"without": ["none", "gd1", "pal5", "[data]"], "ln_density": [np.nan, -135.0, -35.0, np.nan]})
    results: Any = SimpleNamespace(left_out=lambda: table, spec=SimpleNamespace(streams={"gd1": None, "pal5": None}))
    assert Family("near", results).ln_density.tolist() == [-135.0, -35.0]


def test_stacking_needs_several_streams(tmp_path: Path) -> None:
    (tmp_path / "near.toml").write_text(RUN)
    (tmp_path / "far.toml").write_text(OTHER)
    result = call("families", tmp_path / "near.toml", "--host", tmp_path / "far.toml", "--weights", "stacking")
    assert result.exit_code == 2
    assert "stacking predicts each of several streams by the others" in " ".join(result.output.split())


def test_an_average_is_the_mixture_and_its_variance_has_two_parts() -> None:
    """Gaussians about 0 and 4 with weights of 0.9 and 0.1, and different numbers of samples."""
    rng = np.random.default_rng(0)
    samples, weights = [rng.normal(0, 1, (40000, 1)), rng.normal(4, 0.5, (10000, 1))], np.array([0.9, 0.1])
    found = average(samples, weights)
    for name, level in (("", 0.5), ("lo68", 0.16), ("hi95", 0.975)):
        at = found.levels[name][0]
        assert 0.9 * norm(0, 1).cdf(at) + 0.1 * norm(4, 0.5).cdf(at) == pytest.approx(level, abs=0.005)
    assert found.within[0] ** 2 == pytest.approx(0.9 * 1 + 0.1 * 0.25, rel=0.02)
    assert found.between[0] == pytest.approx(4 * np.sqrt(0.9 * 0.1), rel=0.02)
    assert found.spread[0] == pytest.approx(4 / np.sqrt(2), rel=0.02)  # whatever the weights


def ln_evidence(text: str) -> float:
    """The integral over a flat prior of a Gaussian in v_c, which is proportional to v0."""
    spec = sk.load(text)
    low, high = spec.priors[0].support
    of_one = float(sk.Host(spec.host([low])).circular_velocity(np.array([8.0]))[0]) / low
    error = norm(229, 7)
    return float(np.log((error.cdf(high * of_one) - error.cdf(low * of_one)) / (of_one * (high - low))))


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Any]]:
    """Where both families were fitted, and what the command said; all walks of this file are short."""
    where = tmp_path_factory.mktemp("families")
    (where / "near.toml").write_text(RUN)
    (where / "far.toml").write_text(OTHER)
    arguments = ("families", where / "near.toml", "--host", where / "far.toml", "-o", where / "out")
    with pytest.MonkeyPatch.context() as patch:
        take_few_steps(patch)
        yield where, call(*arguments)


def test_the_command_gives_the_evidences_of_the_formula(compared: tuple[Path, Any], tmp_path: Path) -> None:
    where, result = compared
    assert result.exit_code == 0, result.output
    table = QTable.read(where / "out" / "families.ecsv")
    assert list(table["family"]) == ["near", "far", "average"]
    (tmp_path / "far.toml").write_text(RUN[: RUN.index("[potential")] + OTHER + RUN[RUN.index("[data") :])
    expected = np.array([ln_evidence(str(where / "near.toml")), ln_evidence(str(tmp_path / "far.toml"))])
    found, errors = np.array(table["ln_evidence"][:2]), np.array(table["ln_evidence_error"][:2])
    assert (np.abs(found - expected) < np.maximum(4 * errors, 0.03)).all(), (found, expected, errors)
    weight = 1 / (1 + np.exp(expected[1] - expected[0]))
    assert table["weight"][:2] == pytest.approx([weight, 1 - weight], abs=0.03)
    assert f"{where / 'out' / 'far'}: fit 2 of 2" in result.stderr
    assert "The choice of a family moves the mass" in " ".join(result.output.split())


def test_its_profile_is_the_average_of_both(compared: tuple[Path, Any]) -> None:
    out = compared[0] / "out"
    profile, table = QTable.read(out / "profile.ecsv"), QTable.read(out / "families.ecsv")
    runs = [sk.load_results(out / name) for name in ("near", "far")]
    r = profile["r"].to_value("kpc")
    v_c = [each.profiles(r)[1] for each in runs]
    mean = sum(w * each.mean(axis=0) for w, each in zip(np.array(table["weight"]), v_c, strict=False))
    variance = sum(
        w * ((each - mean) ** 2).mean(axis=0) for w, each in zip(np.array(table["weight"]), v_c, strict=False)
    )
    within, between = (profile[f"v_c_{part}"].to_value("km/s") for part in ("within", "between"))
    np.testing.assert_allclose(within**2 + between**2, variance, rtol=1e-6)
    np.testing.assert_allclose(profile["v_c_near"].to_value("km/s"), np.median(v_c[0], axis=0), rtol=1e-6)
    assert (out / "families.png").exists()


def test_finished_fits_are_kept(compared: tuple[Path, Any]) -> None:
    where = compared[0]
    before = QTable.read(where / "out" / "families.ecsv")
    again = call("families", where / "near.toml", "--host", where / "far.toml", "-o", where / "out", "--resume")
    assert again.exit_code == 0, again.output
    after = QTable.read(where / "out" / "families.ecsv")
    assert list(after["ln_evidence"][:2]) == list(before["ln_evidence"][:2])
    assert list(after["calls"]) == list(before["calls"])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[data.x]\nkind = 'flattening'", "there is no section [potential]"),
        (OTHER.replace('"tf"', '"tff"'), "as the host of"),
        (OTHER.replace('"tf"', '"tff"'), "Did you mean"),
    ],
)
def test_bad_input_is_a_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "run.toml").write_text(RUN)
    (tmp_path / "other.toml").write_text(text)
    result = call("families", tmp_path / "run.toml", "--host", tmp_path / "other.toml", "-o", tmp_path / "out")
    assert result.exit_code == 2
    assert sentence in " ".join(result.output.split())


def test_an_interruption_says_how_to_go_on_with_all_fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_args: Any, **named: Any) -> None:
        assert named["progress"]  # a fit takes minutes
        raise Interrupted("stopped after 3 steps. To continue: streamkit run", signal.SIGTERM)

    monkeypatch.setattr("streamkit.study.families.runner.run", stopped)
    (tmp_path / "run.toml").write_text(RUN)
    (tmp_path / "other.toml").write_text(OTHER)
    result = call("families", tmp_path / "run.toml", "--host", tmp_path / "other.toml", "-o", tmp_path / "out")
    assert result.exit_code == 143
    assert "interrupted; 0 of 2 fits are finished; --resume goes on" in " ".join(result.output.split())


def test_how_to_come_to_an_evidence_names_fields_that_the_sampler_has(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(RUN)
    spec = sk.load(tmp_path / "run.toml")
    assert remedy(spec).endswith("emulator gives one when it ends by its rule: raise sampler.max_calls and --resume.")
    chain = remedy(spec.with_sampler("emcee"))
    assert chain.startswith("The sampler emcee gives none: take --sampler emulator")
    assert "max_calls" not in chain


def test_two_hosts_of_one_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(RUN)
    result = call("families", tmp_path / "run.toml", "--host", tmp_path / "run.toml", "-o", tmp_path / "out")
    assert result.exit_code == 2
    assert "two hosts are called 'run'" in " ".join(result.output.split())
