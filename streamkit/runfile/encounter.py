"""A body that has flown past a stream, by the numbers of its encounter in place of its place today."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from streamkit.runfile.progenitor import MOST_LOOKBACK
from streamkit.runfile.section import Section, read_section
from streamkit.stream import Frame
from streamkit.units import Angle, Coordinate, Duration, Symbol, Velocity

ENCOUNTER = "encounter"  # the field of a body that holds it


class Encounter(BaseModel):
    """The encounter of a body with a stream: the body passes a point of the stream, which is today at phi1.

    At the closest approach the line to the body is normal to the stream's velocity. An angle of 0 deg is outward, away
    from the Galactic centre, and 90 deg along the stream's angular momentum. v_perpendicular is normal to that line
    and to the stream: positive in the sense of a growing angle. The body acts on the particles of this stream alone,
    and stays: it may meet them again. It feels the host and the other bodies, without friction, and pulls neither; nor
    does it pull the progenitor, so encounters near the progenitor are beyond this model. A body at a distance d would
    shift the progenitor by G M t^2 / (2 d^2) in a time t: 20 pc for 1e6 Msun at 10 kpc in 1 Gyr. The integrator
    leapfrog needs steps of 0.01 Myr for a body; the others resolve it with their own steps.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    stream: str | None = Field(default=None, description="The stream's name. May be left out where there is one.")
    frame: Frame = Field(
        default=None, description="Frame of phi1. By default that of the stream's progenitor, or of its observable."
    )
    phi1: Annotated[Angle, Symbol(r"$\phi_{1, \rm enc}$")] = Field(
        description="Longitude today, along the stream without this encounter, of the point that the body passed."
    )
    time: Annotated[Duration, Symbol(r"$t_{\rm enc}$")] = Field(
        le=MOST_LOOKBACK, description="Time of the closest approach before today."
    )
    impact_parameter: Annotated[Coordinate, Symbol("$b$"), Field(ge=0)] = Field(
        description="Smallest distance from that point."
    )
    angle: Annotated[Angle, Symbol(r"$\psi$")] = Field(description="Direction of the body from that point.")
    v_parallel: Annotated[Velocity, Symbol(r"$v_\parallel$")] = Field(
        description="Velocity of the body relative to the stream, along the stream."
    )
    v_perpendicular: Annotated[Velocity, Symbol(r"$v_\perp$")] = Field(
        description="Velocity of the body relative to the stream, normal to the stream."
    )


def read_encounter(path: str, rest: Mapping[str, Any], errors: list[str]) -> Section[Encounter] | None:
    """Validate the encounter of a body among the keys that are not its potential's; on failure add sentences."""
    table = rest[ENCOUNTER]
    if others := [key for key in rest if key != ENCOUNTER]:
        errors.append(
            f"{path}.{others[0]}: found {others[0]} beside an encounter, which says where the body is; a body that "
            "flies by has no other place, no friction and no reflex"
        )
    elif not isinstance(table, Mapping):
        needed = ", ".join(name for name, field in Encounter.model_fields.items() if field.is_required())
        errors.append(f"{path}.{ENCOUNTER}: found {table!r}, expected a table with {needed}")
    else:
        return read_section(f"{path}.{ENCOUNTER}", Encounter, table, errors, "the encounter")
    return None
