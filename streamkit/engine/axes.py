"""Forces whose axes are turned: a position is turned to the axes of the force, and the force back."""

from __future__ import annotations

from typing import Any

from numba import njit

from streamkit.engine.cache import OPTIONS, UNCALLED
from streamkit.stream import from_axes, to_axes

ROTATION = -9  # a rotation, nine numbers, stands last among the arguments
INLINED: dict[str, Any] = {"forceinline": True, **UNCALLED, **OPTIONS}
compiled_to_axes, compiled_from_axes = njit(**INLINED)(to_axes), njit(**INLINED)(from_axes)


def turned(acceleration: Any) -> Any:
    """Return an acceleration along turned axes, for numba; the rotation follows the arguments."""
    inlined = njit(**INLINED)(acceleration)

    def along_axes(x, y, z, t, *parameters):
        rotation = parameters[ROTATION:]
        u, v, w = compiled_to_axes(rotation, x, y, z)
        au, av, aw = inlined(u, v, w, t, *parameters[:ROTATION])
        return compiled_from_axes(rotation, au, av, aw)

    return along_axes


def turned_drag(drag: Any) -> Any:
    """Return a drag along turned axes, for numba; the rotation follows the arguments."""
    inlined = njit(**INLINED)(drag)

    def along_axes(x, y, z, vx, vy, vz, t, *parameters):
        rotation = parameters[ROTATION:]
        u, v, w = compiled_to_axes(rotation, x, y, z)
        vu, vv, vw = compiled_to_axes(rotation, vx, vy, vz)
        au, av, aw = inlined(u, v, w, vu, vv, vw, t, *parameters[:ROTATION])
        return compiled_from_axes(rotation, au, av, aw)

    return along_axes
