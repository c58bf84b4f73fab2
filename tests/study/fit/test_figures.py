"""The pictures of a run, whatever its parameters: nothing cut off, nothing printed over something else."""

import copy
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from toys import FIT

import streamkit as sk
from streamkit.study.fit.figures import _labels, corner, traces
from streamkit.study.fit.results import Results


def freed(**priors):
    """Return FIT with other free parameters: section -> {field: prior or number}."""
    document = copy.deepcopy(FIT)
    document["sampler"]["walkers"] = 32
    for section, fields in priors.items():
        document[section].update(fields)
    return document


def one():
    return freed(potential={"alpha": 0.35})


def six():
    """The host, the satellite and the width of the stripping: what a mock leaves free."""
    return freed(
        potential={"rs": {"uniform": [1, 100]}},
        progenitor={"mass": {"uniform": [1e8, 1e9]}, "radius": {"uniform": [0.1, 1]}},
        stripping={"sigma": {"uniform": [0.5, 10]}},
    )


def eight():
    """Proper motions on the equatorial sky; two halos with the same fields, by names that a user chose."""
    document = freed()
    document["potential"] = {
        "halo": {"kind": "nfw_m200", "m200": {"log_uniform": [1e11, 1e13]}, "c200": {"uniform": [5, 30]}, "h0": 70},
        "halo_of_the_dwarf": {"kind": "nfw_m200", "m200": {"log_uniform": [1e9, 1e11]}, "c200": 15, "h0": 70},
    }
    for name in ("l", "b", "pm_l_cosb", "pm_b"):
        del document["progenitor"][name]
    document["progenitor"] |= {
        "ra": 283.83, "dec": {"normal": [-30.545, 0.01]}, "pm_ra_cosdec": {"normal": [-2.692, 0.05]},
        "pm_dec": {"normal": [-1.359, 0.05]}, "v_los": {"normal": [142, 2]}, "distance": {"normal": [26.5, 0.5]},
    }  # fmt: skip
    return document


def eleven():
    """The fit of the paper, nearly."""
    document = six()
    document["progenitor"] |= {
        "distance": {"uniform": [22, 28.4]}, "pm_l_cosb": {"normal": [-2.44, 0.3]}, "pm_b": {"normal": [1.97, 0.3]},
        "v_los": {"normal": [153, 2]}, "lookback": {"uniform": [0, 10]},
    }  # fmt: skip
    return document


CASES = {1: one, 2: freed, 6: six, 8: eight, 11: eleven}


def synthetic(document, steps=12, walkers=32, seed=1, quick=False):
    """Return the results of a run that nobody made: correlated walkers around the prior's centre."""
    spec, rng = sk.load(document), np.random.default_rng(seed)
    d = len(spec.names)
    mix = np.linalg.cholesky(0.5 * np.eye(d) + 0.5)
    z = np.empty((steps, walkers, d))
    z[0] = 3 * rng.normal(size=(walkers, d))
    for k in range(1, steps):
        z[k] = 0.8 * z[k - 1] + 0.6 * rng.normal(size=(walkers, d)) @ mix.T
    chain = spec.centre() * (1 + 0.03 * z)
    ln_p = -0.5 * (np.linalg.solve(mix, z[..., None])[..., 0] ** 2).sum(axis=2)
    backend = SimpleNamespace(
        iteration=steps, get_chain=lambda: chain, get_log_prob=lambda: ln_p, get_blobs=lambda: None,
        accepted=np.full(walkers, steps // 3),
    )  # fmt: skip
    return Results.in_memory(spec, backend, {}, "steps", quick)


def drawn_texts(figure, monkeypatch):
    """Return every text that the figure really draws, with its box in pixels."""
    found, draw = [], Text.draw

    def record(text, renderer):
        if text.get_visible() and text.get_text().strip():
            found.append((text.get_text(), text.get_window_extent(renderer)))
        draw(text, renderer)

    with monkeypatch.context() as patch:
        patch.setattr(Text, "draw", record)
        FigureCanvasAgg(figure).draw()
    return found


def overlap(a, b, pixels=0.5):
    return min(a.x1, b.x1) - max(a.x0, b.x0) > pixels and min(a.y1, b.y1) - max(a.y0, b.y0) > pixels


@pytest.mark.parametrize("draw", [corner, traces])
@pytest.mark.parametrize("number", CASES)
def test_every_text_of_a_picture_can_be_read(number, draw, monkeypatch):
    results = synthetic(CASES[number](), quick=True)  # the longest caveat
    assert len(results.names) == number
    figure = draw(results)
    texts = drawn_texts(figure, monkeypatch)
    for name in _labels(results)[1]:
        assert any(name in text for text, _ in texts), name
    panels = [axes.get_window_extent() for axes in figure.axes if axes.get_visible() and axes.get_frame_on()]
    for text, box in texts:
        assert box.x0 >= 0, text
        assert box.y0 >= 0, text
        assert box.x1 <= figure.bbox.x1, text
        assert box.y1 <= figure.bbox.y1, text
        assert not any(overlap(box, panel) for panel in panels), text
    for (one, a), (other, b) in combinations(texts, 2):
        assert not overlap(a, b), (one, other)
