"""The sampler dynesty for streamkit: nested sampling, and the evidence."""

from __future__ import annotations

from streamkit import CONTRACT, Component, hookimpl
from streamkit_dynesty.sampler import Dynesty

STREAMKIT_CONTRACT = CONTRACT


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the sampler."""
    return [Dynesty]
