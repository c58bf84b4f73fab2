"""What several streams say of the host without one of them: of data that say nothing, and beside a fit without it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runfiles import several

import streamkit as sk
from streamkit.fit.judge.goodness import Sampled
from streamkit.fit.samples.left_out import NONE, left_out_table
from streamkit.sample import Posterior
from streamkit.sample.evaluation import blob_dtype


def sampled(names: tuple[str, ...], n: int) -> Sampled:
    """Samples of the prior, with the same predictions at each."""
    spec = sk.load(several(*names))
    made = Posterior(spec).observe(spec.centre())
    rng = np.random.default_rng(1)
    samples = np.column_stack([prior.sample(rng, n) for prior in spec.priors])
    blobs = np.zeros(n, dtype=blob_dtype(len(made.prediction.names)))
    blobs["mean"], blobs["variance"] = made.prediction.mean, made.prediction.variance
    best = dict(zip(spec.names, spec.centre().tolist(), strict=True))
    return Sampled(spec, best, made.predictions, samples, blobs)


def test_a_stream_whose_data_say_nothing_changes_nothing() -> None:
    table = left_out_table(sampled(("a", "b"), 800))
    assert list(table["without"]) == [NONE, "a", "b"]
    for row in table[1:]:
        assert abs(row["potential.v0"]) < 0.15
        assert abs(row["potential.alpha"]) < 0.15
        assert row["M20"].value == pytest.approx(table["M20"][0].value, rel=0.01)
        assert not row["problem"]
        assert not row["p"] < 0.001


def test_there_is_no_table_of_few_samples_or_one_stream() -> None:
    assert len(left_out_table(sampled(("a", "b"), 30))) == 0
    assert len(left_out_table(sampled(("a",), 200))) == 0
    assert len(left_out_table(None)) == 0


@pytest.mark.slow
def test_it_is_the_fit_without_the_stream(tmp_path: Path) -> None:
    """Two streams, the second with other data: the mass without it is that of a fit of the first alone."""

    def fitted(*names: str) -> sk.Results:
        document: dict[str, Any] = several(*names)
        document["sampler"] = {"walkers": 24, "steps": 250}
        if "b" in names:
            table = document["stream"]["b"]["observable"]["distance"]
            table["error"] = [2.0, 2.0]
        return sk.run(document, out=tmp_path / "".join(names), progress=False, products=False)

    both, alone = fitted("a", "b"), fitted("a")
    row = both.left_out()[2]
    assert row["without"] == "b"
    assert not row["problem"]
    mass = alone.mass_profile([20.0])[0]
    width = (mass["M_hi68"] - mass["M_lo68"]).value
    for ours, theirs in (("M20", "M"), ("M20_lo68", "M_lo68"), ("M20_hi68", "M_hi68")):
        assert row[ours].value == pytest.approx(mass[theirs].value, abs=0.2 * width)
