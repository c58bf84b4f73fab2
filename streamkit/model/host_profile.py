"""The profile of a host: mass, circular velocity, flattening, escape speed and density against radius."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from streamkit.model.host import Host
from streamkit.stream import Array


class ProfileColumn(NamedTuple):
    """One column of a profile: unit, label in pictures, and its definition in a sentence."""

    unit: str
    label: str
    meaning: str


PROFILE: dict[str, ProfileColumn] = {
    "M": ProfileColumn(
        "Msun", r"$M(<r)$ [$M_\odot$]",
        "mass inside the sphere of radius r by Gauss's law, r^2 <-a_r> / G with the mean force over the sphere; a "
        "force along one direction, as gala's mass_enclosed takes, differs by some per cent for a disc",
    ),
    "v_c": ProfileColumn("km/s", r"$v_{\rm c}(R)$ [km s$^{-1}$]",
                         "circular velocity in the plane, sqrt(R <-a_R>) with the mean around the axis"),
    "q": ProfileColumn("", r"$q_\Phi$",
                       "flattening of the potential 45 deg above the plane, sqrt(z a_R / (R a_z)); 1 for a sphere"),
    "v_esc": ProfileColumn("km/s", r"$v_{\rm esc}(R)$ [km s$^{-1}$]",
                           "escape speed to infinity in the plane; infinite where the potential has no limit, as in a "
                           "logarithmic halo; none without a potential energy"),
    "rho": ProfileColumn("Msun/kpc3", r"$\rho(r)$ [$M_\odot$ kpc$^{-3}$]",
                         "mean density on the sphere of radius r, dM/dr / (4 pi r^2)"),
}  # fmt: skip


def profile_values(host: Host, radii: Array) -> dict[str, Array]:
    """Return the columns of `PROFILE` at radii (nr,) in kpc; NaN for an escape speed without a potential energy."""
    slant = radii / np.sqrt(2.0)
    escape = host.escape_speed(radii)
    return {
        "M": host.mass_inside(radii),
        "v_c": host.circular_velocity(radii),
        "q": host.flattening(slant, slant),
        "v_esc": np.full(len(radii), np.nan) if escape is None else escape,
        "rho": host.total.mean_density(radii),
    }
