"""The potentials of AGAMA as a component of streamkit, from its parameters or its INI files."""

from streamkit import Component, hookimpl
from streamkit_agama.component import Agama

STREAMKIT_CONTRACT = 1


@hookimpl
def streamkit_components() -> list[type[Component]]:
    """List the components of this package."""
    return [Agama]
