"""The potentials of galpy as a component of streamkit, by their galpy names."""

from streamkit import Component, hookimpl
from streamkit_galpy.component import Galpy

STREAMKIT_CONTRACT = 1


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the components of this package."""
    return [Galpy]
