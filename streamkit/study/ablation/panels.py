"""What the pictures of several streams share: portraits by title, panels in rows, and how many particles are drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from streamkit.stream import BoolArray, IntArray, Stream
from streamkit.study.ablation.measures import Portrait

Portraits = Mapping[str, Portrait]
SHOWN = 6500
"""Most particles drawn per panel: the same random number of each stream, as in Gibbons+ 2014, figure 6."""


def some(stream: Stream, chosen: BoolArray) -> IntArray:
    """Return the chosen particles to draw: at random by their weights, at most `SHOWN` of all unbound ones."""
    free = ~stream.bound
    index = np.flatnonzero(chosen)
    share = stream.weight / stream.weight[free].max(initial=0.0)
    share *= min(SHOWN / max(float(share[free].sum()), 1.0), 1.0)
    return np.asarray(index[np.random.default_rng(0).random(len(index)) < share[index]])
