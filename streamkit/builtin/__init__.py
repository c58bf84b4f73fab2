"""The default plugins. They use only the public names of `streamkit` and `streamkit.engine`, as any plugin."""

from __future__ import annotations

from streamkit import CONTRACT, Component, Preset, hookimpl
from streamkit.builtin.data import host, host_likelihood, remnant
from streamkit.builtin.integrators import adaptive, fixed_step, reference
from streamkit.builtin.observables import density, dispersion, off_track, power_spectrum
from streamkit.builtin.observables.apocentres import observable as apocentres
from streamkit.builtin.observables.stars import observable as stars
from streamkit.builtin.observables.track import observable as track
from streamkit.builtin.potentials import (
    bar,
    closed_forms,
    discs,
    halos,
    milky_way,
    multipole,
    nonparametric,
    progenitors,
    spherical_table,
    spheroids,
    uniform,
)
from streamkit.builtin.samplers.emulator.sampler import PredictionEmulator
from streamkit.builtin.samplers.ensemble.sampler import Emcee
from streamkit.builtin.stripping import lagrange, restricted_nbody

STREAMKIT_CONTRACT = CONTRACT


@hookimpl
def streamkit_components() -> list[type[Component] | Preset]:
    """List the built-in components, and the published models of the Milky Way."""
    return [
        closed_forms.TruncatedFlat,
        closed_forms.NFW,
        closed_forms.NFWVirial,
        closed_forms.Hernquist,
        closed_forms.MiyamotoNagai,
        closed_forms.Plummer,
        closed_forms.Kepler,
        closed_forms.Isochrone,
        closed_forms.Logarithmic,
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
        uniform.UniformAcceleration,
        nonparametric.Nonparametric,
        lagrange.LagrangeCloud,
        lagrange.Streakline,
        restricted_nbody.RestrictedNbody,
        fixed_step.Leapfrog,
        fixed_step.ForestRuth,
        adaptive.Adaptive,
        reference.Reference,
        apocentres.Apocentres,
        track.Track,
        density.Density,
        dispersion.Dispersion,
        off_track.OffTrack,
        power_spectrum.PowerSpectrum,
        stars.Stars,
        remnant.RemnantData,
        Emcee,
        PredictionEmulator,
        host.RotationCurve,
        host.CircularVelocity,
        host.EnclosedMass,
        host.Flattening,
        host_likelihood.HostLikelihood,
        milky_way.BOVY2014,
        milky_way.MCMILLAN2017,
        milky_way.GALA_V1,
        milky_way.GALA_V2,
    ]
