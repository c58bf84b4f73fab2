"""The one hook of streamkit, and the number of the contract between streamkit and its plugins."""

from __future__ import annotations

from pluggy import HookimplMarker, HookspecMarker

from streamkit.components.bases import Component
from streamkit.components.preset import Preset

CONTRACT = 1  # raised when a change of the contract makes older components need an edit
CONTRACT_ATTRIBUTE = "STREAMKIT_CONTRACT"  # attribute of a plugin's module: the contract it was written for

hookspec = HookspecMarker("streamkit")
hookimpl = HookimplMarker("streamkit")


@hookspec
def streamkit_components() -> list[type[Component] | Preset]:  # type: ignore[empty-body]  # pluggy reads it
    """Return the component classes this plugin provides (potentials, strippings, ...), and its presets."""
