"""The potentials of gala as a component of streamkit, by their gala names."""

from streamkit import Component, hookimpl
from streamkit_gala.component import Gala

STREAMKIT_CONTRACT = 1


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the components of this package."""
    return [Gala]
