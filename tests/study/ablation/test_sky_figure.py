"""Variants on the sky: the tracks are drawn on each other, and their differences are in errors of the data."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from pictures import assert_readable
from runfiles import FIT

import streamkit as sk
from streamkit.study.ablation import run_ablation, variants_of
from streamkit.study.ablation.figures import along
from streamkit.study.ablation.products import SKY, ablation_products
from streamkit.study.ablation.runner import Ablation
from streamkit.study.ablation.sky_figure import tracks_on_sky
from streamkit.study.grid import by_column, rms


@pytest.fixture(scope="module")
def found() -> Ablation:
    """Two schemes, and nine data in two columns."""
    document = copy.deepcopy(FIT)
    phi1 = [-20.0, -10.0, 0.0, 10.0, 20.0]
    document["observable"] = {
        "kind": "track", "frame": "SagittariusLaw10", "kernel": 5,
        "distance": {"phi1": phi1, "distance": [25.0] * 5, "error": [1.0, 2.0, 3.0, 4.0, 5.0]},
        "phi2": {"phi1": phi1[:4], "phi2": [0.0] * 4, "error": [0.5] * 4},
    }  # fmt: skip
    document["stripping"]["particles"] = 500
    spec = sk.load(document)
    return run_ablation(spec, variants_of(spec, {"stripping.kind": ["mlcs", "streakline"]}))


def test_differences_are_those_of_the_predictions_in_errors(found: Ablation) -> None:
    first, second = (outcome.first for outcome in found.outcomes)
    assert first is not None
    assert second is not None
    axes: Any = tracks_on_sky({"mlcs": first, "streakline": second}).axes
    assert len(axes) == 4
    assert first.prediction is not None
    assert second.prediction is not None
    _, errors = first.inputs.observables["observable"].data()
    away = (second.prediction.mean - first.prediction.mean) / errors
    shown = [line.get_ydata() for below in axes[1::2] for line in below.lines]
    assert len(shown) == 2
    assert np.concatenate(shown) == pytest.approx(away)
    for above in axes[::2]:
        assert {"data", "mlcs", "streakline"} == set(above.get_legend_handles_labels()[1])
    assert len({one.get_xlim() for one in axes}) == 1


def test_six_variants_with_long_names_can_be_read(found: Ablation, monkeypatch: pytest.MonkeyPatch) -> None:
    first = found.outcomes[0].first
    assert first is not None
    names = [f"stripping.kind=mlcs, progenitor.mass={i}.5e8 Msun, potential.rs=1{i} kpc" for i in range(6)]
    assert_readable(tracks_on_sky(dict.fromkeys(names, first)), monkeypatch)
    figure = along(dict.fromkeys(names, first))
    assert_readable(figure, monkeypatch)


def test_many_data_are_told_by_their_columns(found: Ablation) -> None:
    products = ablation_products(found, {})
    assert SKY in products.pictures
    pulls = [value for name, value in found.outcomes[1].measures[0].items() if name.startswith("pull_phi2")]
    (line,) = (line for line in products.text.splitlines() if line.split()[:1] == ["phi2"])
    assert f"{np.sqrt(np.mean(np.square(pulls))):.2f} (" in line
    assert "phi2 at -20" not in products.text


def test_data_go_by_what_stands_before_their_longitude() -> None:
    groups = by_column(["phi2 at -60", "phi2 at 3 (2)", "leading", "b.distance at 1"])
    assert {name: which.tolist() for name, which in groups.items()} == {
        "phi2": [0, 1], "leading": [2], "b.distance": [3],
    }  # fmt: skip
    assert rms(np.array([[3.0, 4.0, np.nan], [np.nan] * 3])) == pytest.approx([np.sqrt(12.5), np.nan], nan_ok=True)
