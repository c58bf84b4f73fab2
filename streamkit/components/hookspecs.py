"""The one hook of streamkit."""

from __future__ import annotations

from pluggy import HookimplMarker, HookspecMarker

from streamkit.components.bases import Component
from streamkit.components.preset import Preset

hookspec = HookspecMarker("streamkit")
hookimpl = HookimplMarker("streamkit")


@hookspec
def streamkit_components() -> list[type[Component] | Preset]:  # type: ignore[empty-body]  # pluggy reads it
    """Return the component classes this plugin provides (potentials, strippings, ...), and its presets."""
