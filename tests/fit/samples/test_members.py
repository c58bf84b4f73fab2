"""The table and the picture of members: against the observable's own probabilities at each sample."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from mock_stars import FRAME, KERNEL, WINDOW, catalogue, the_stream
from runfiles import changed

import streamkit as sk
from streamkit.builtin.observables.stars.observable import Stars
from streamkit.fit.judge.goodness import Sampled
from streamkit.fit.products import products_of
from streamkit.fit.samples.members import has_members, members_table
from streamkit.fit.show import members as picture


def test_a_run_of_stars_has_their_table_and_picture() -> None:
    section = {"kind": "stars", "frame": FRAME, "stars": catalogue(20, 20)[0], "window": WINDOW, "fraction": 0.5}
    spec = sk.load(changed("observable", section))
    assert has_members(spec)
    assert {"members.ecsv", "members.png"} <= set(products_of(spec))
    without = sk.load(changed("observable", {"kind": "apocentres", "leading": [50, 1]}))
    assert not has_members(without)
    assert not {"members.ecsv", "members.png"} & set(products_of(without))


def test_the_probability_is_the_mean_over_samples(monkeypatch: Any) -> None:
    table, truth = catalogue(100, 100, seed=1)
    stars = [Stars(frame=FRAME, stars=table, window=WINDOW, kernel=KERNEL, fraction=f) for f in (0.4, 0.5, 0.6)]
    prediction = stars[0].predict(the_stream())
    samples = [[SimpleNamespace(name="", stream="stream", measurement=each, prediction=prediction)] for each in stars]

    class Some:
        def each(self, most: int) -> Iterator[tuple[int, Any]]:
            yield from enumerate(samples)

    found = members_table(cast("Sampled", Some()))
    each = np.array([one.membership(prediction) for one in stars])
    np.testing.assert_allclose(found["p_member"], each.mean(axis=0))
    np.testing.assert_allclose(found["p_member_sd"], each.std(axis=0))
    assert not found["p_cocoon"].any()
    np.testing.assert_allclose(found["ra"].to_value("deg"), table["ra"])
    assert ((found["p_member"] > 0.5) == truth).mean() > 0.95
    assert found["pm_phi2"].unit == "mas/yr"
    monkeypatch.setattr(picture, "remark", lambda _: "")
    over = stars[0].over_stars(prediction)
    monkeypatch.setattr(picture, "tracks_of", lambda _: {"stream": over})
    figure = picture.members(cast("sk.Results", SimpleNamespace(members=lambda: found)))
    assert [axes.get_ylabel() for axes in figure.axes[:3]] == [over[name][0] for name in over]
    assert list(over) == ["phi2", "pm_phi1_cosphi2", "pm_phi2"]
    for name, axes in zip(over, figure.axes, strict=False):  # of the members about the line 68 % are within the width
        x, mean, low, high = axes.lines[1].get_xdata(), *(line.get_ydata() for line in axes.lines[1:])
        phi1, value = found["phi1"].value[truth], found[name].value[truth]
        inside = np.abs(value - np.interp(phi1, x, mean)) < 0.5 * np.interp(phi1, x, np.subtract(high, low))
        assert low is not high
        assert 0.5 < inside.mean() < 0.8
    assert len(members_table(None)) == 0
