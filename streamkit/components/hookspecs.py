"""The one hook of streamkit."""

from __future__ import annotations

from pluggy import HookimplMarker, HookspecMarker

from streamkit.components.bases import Component

hookspec = HookspecMarker("streamkit")
hookimpl = HookimplMarker("streamkit")


@hookspec
def streamkit_components() -> list[type[Component]]:  # type: ignore[empty-body]  # pluggy reads the signature
    """Return the component classes this plugin provides: potentials, strippings, integrators, observables."""
