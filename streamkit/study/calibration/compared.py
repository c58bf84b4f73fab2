"""What is compared with the truth: the parameters of the fit that the truth has too, and what both hosts are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from astropy import units as u

from streamkit.errors import SpecError, StreamkitError
from streamkit.model import Host
from streamkit.runfile import Spec
from streamkit.stream import Array

MASS_RADII = (50.0, 100.0, 200.0)  # kpc: of the enclosed masses
SUN, ROUND = 8.0, 20.0  # kpc: where the circular velocity and the flattening of the potential are compared
ALIKE = 1e-9  # samples of a quantity that differ by no more, relative, have no interval


def quantities(radii: Sequence[float]) -> dict[str, tuple[str, str]]:
    """Return the unit of each quantity of the host, and how it is shown in a picture, by its name in tables."""
    masses = {f"mass_{r:g}": ("Msun", rf"$M({r:g}\,{{\rm kpc}})$") for r in radii}
    return masses | {
        f"v_c_{SUN:g}": ("km/s", rf"$v_{{\rm c}}({SUN:g}\,{{\rm kpc}})$"),
        f"q_{ROUND:g}": ("", rf"$q({ROUND:g}\,{{\rm kpc}})$"),
    }


def of_host(host: Host, radii: Sequence[float]) -> Array:
    """(k,) The `quantities` of a host: masses in Msun, the circular velocity in km/s, the flattening.

    The flattening is that of the potential, `Host.flattening`, at the radius `ROUND` half-way between plane and pole.
    """
    half_way = np.array([ROUND / np.sqrt(2)])
    flattening = host.flattening(half_way, half_way)
    return np.concatenate([host.mass_inside(np.array(radii)), host.circular_velocity(np.array([SUN])), flattening])


def shares_below(samples: Array, true: Array) -> tuple[float | None, ...]:
    """Return the share of the samples (n, k) below each true value (k,).

    None where the true value is unknown, or the samples do not vary: a host that is round has no interval of its shape.
    """
    known = np.isfinite(true) & (np.ptp(samples, axis=0) > ALIKE * np.abs(samples).max(axis=0))
    return tuple(
        share if one else None for share, one in zip((samples < true).mean(axis=0).tolist(), known, strict=True)
    )


def true_parameters(spec: Spec, truth: Spec, theta: Array) -> Array:
    """(d,) The values of the fit's parameters in the truth at its own parameters, by name, in the fit's units.

    A field that has a number there has that value. NaN for a field that the truth lacks, or of a component of another
    kind: the mass of another halo is another number.
    """
    drawn = {name: (x, unit) for name, x, unit in zip(truth.names, theta.tolist(), truth.units, strict=True)}
    return np.array([_value(spec, truth, drawn, *each) for each in zip(spec.names, spec.units, strict=True)])


def _value(spec: Spec, truth: Spec, drawn: Mapping[str, tuple[float, str]], name: str, unit: str) -> float:
    kind, _ = _found(spec, name)
    theirs, found = _found(truth, name)
    if theirs != kind or found is None:
        return np.nan
    if name in drawn:
        value, known = drawn[name]
        return value if known == unit else float((value * u.Unit(known)).to_value(unit))
    try:
        return spec.number(name, found)
    except SpecError:  # a word in place of a number, or a list: another thing of the same name
        return np.nan


def _found(spec: Spec, name: str) -> tuple[object, object]:
    """Return the kind of the component that has a field, and what the run file has there; None for nothing."""
    found: object = spec.document
    kind: object = None
    for key in name.split("."):
        if isinstance(found, Mapping):
            kind, found = found.get("kind", kind), found.get(key)
        elif isinstance(found, Sequence) and not isinstance(found, str) and key.isdigit() and int(key) < len(found):
            found = found[int(key)]
        else:
            return kind, None
    return kind, found


def check_truth(spec: Spec, truth: Spec) -> None:
    """Raise StreamkitError if the truth lacks an observable or data on the host that the fit has, or has other ones."""
    ours, theirs = (_measured(one) for one in (spec, truth))
    if (
        not any(name.startswith("potential.") for name in spec.names)
        and not np.isfinite(true_parameters(spec, truth, truth.centre())).any()
    ):
        raise StreamkitError(f"{truth.source}: has none of the parameters of the fit, whose host is fixed")
    if lost := [path for path in ours if path not in theirs]:
        raise StreamkitError(
            f"{truth.source}: the truth needs a section {lost[0]} as the fit has it, to make its mock data; found "
            f"{', '.join(theirs) or 'no observable and no data'}"
        )
    if other := [path for path, kind in ours.items() if theirs[path] != kind]:
        raise StreamkitError(
            f"{truth.source}: {other[0]} is of the kind {theirs[other[0]]!r}, and that of the fit {ours[other[0]]!r}"
        )


def _measured(spec: Spec) -> dict[str, str]:
    """Return the kinds of the observables and of the data on the host, by their paths."""
    observables = [each for stream in spec.sections.streams.values() for each in stream.observables.values()]
    of_host = {each.path: each.cls.kind for each in spec.sections.data.values()}
    return {each.path: each.cls.kind for each in observables} | of_host
