"""The default plugins. They use only the public names of `streamkit` and `streamkit.engine`, as any plugin."""

from __future__ import annotations

from streamkit import CONTRACT, Component, Preset, hookimpl
from streamkit.builtin import (
    apocentres,
    bar,
    density,
    discs,
    halos,
    host_data,
    integrators,
    milky_way,
    multipole,
    potentials,
    progenitors,
    remnant,
    restricted_nbody,
    spherical_table,
    spheroids,
    stripping,
    track,
)
from streamkit.builtin.emulator.sampler import PredictionEmulator
from streamkit.builtin.ensemble import sampler

STREAMKIT_CONTRACT = CONTRACT


@hookimpl
def streamkit_components() -> list[type[Component] | Preset]:
    """List the built-in components, and the published models of the Milky Way."""
    return [
        potentials.TruncatedFlat,
        potentials.NFW,
        potentials.NFWVirial,
        potentials.Hernquist,
        potentials.MiyamotoNagai,
        potentials.Plummer,
        potentials.Kepler,
        potentials.Isochrone,
        potentials.Logarithmic,
        halos.LogarithmicHalo,
        halos.NFWTriaxial,
        halos.NFWEllipsoidal,
        spheroids.Dehnen,
        spheroids.HernquistSpeed,
        spheroids.Spheroid,
        spheroids.PowerCutoff,
        progenitors.TruncatedNFW,
        progenitors.King,
        discs.ExponentialDisc,
        discs.Sech2Disc,
        bar.Bar,
        spherical_table.SphericalTable,
        multipole.Multipole,
        stripping.LagrangeCloud,
        stripping.Streakline,
        restricted_nbody.RestrictedNbody,
        integrators.Leapfrog,
        integrators.ForestRuth,
        integrators.Adaptive,
        integrators.Reference,
        apocentres.Apocentres,
        track.Track,
        density.Density,
        remnant.RemnantData,
        sampler.Emcee,
        PredictionEmulator,
        host_data.RotationCurve,
        host_data.CircularVelocity,
        host_data.EnclosedMass,
        host_data.Flattening,
        milky_way.BOVY2014,
        milky_way.MCMILLAN2017,
        milky_way.GALA_V1,
        milky_way.GALA_V2,
    ]
