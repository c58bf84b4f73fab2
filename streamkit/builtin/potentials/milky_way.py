"""Published models of the Milky Way. Masses in Msun, lengths in kpc."""

from __future__ import annotations

from streamkit import Preset

# galpy's, by its definition: 5, 60 and 35 per cent of the force at 8 kpc, where v_c = 220 km/s.
BOVY2014 = Preset(
    "bovy2014",
    "MWPotential2014: Bovy 2015, ApJS 216, 29, table 1",
    {
        "bulge": {"kind": "power_cutoff", "mass": 4501365375.139, "alpha": 1.8, "rc": 1.9},
        "disc": {"kind": "miyamoto_nagai", "mass": 68193902783.46, "a": 3.0, "b": 0.28},
        "halo": {"kind": "nfw", "mass": 436833248499.6, "rs": 16.0},
    },
)
# The halo and the mass of every part as published. The other parts have no closed form and are approximated: each disc
# of stars by three Miyamoto-Nagai discs, each disc of gas, which has a central hole, by one, the bulge by a sphere.
# Against galpy's expansion of the model: v_c within 1.7 km/s from 3 to 200 kpc, the force within 3 per cent at
# r > 4 kpc, 2 per cent at r > 8 kpc and 0.8 per cent at r > 15 kpc.
MCMILLAN2017 = Preset(
    "mcmillan2017",
    "McMillan 2017, MNRAS 465, 76, table 3",
    {
        "bulge": {"kind": "power_cutoff", "mass": 8.8775e9, "alpha": 1.8, "rc": 1.67},
        "thin_disc": {"kind": "exponential_disc", "mass": 3.51858e10, "rd": 2.5, "height": 0.3},
        "thick_disc": {"kind": "exponential_disc", "mass": 1.04868e10, "rd": 3.02, "height": 0.9},
        "atomic_gas": {"kind": "miyamoto_nagai", "mass": 1.0674e10, "a": 11.0, "b": 0.17},
        "molecular_gas": {"kind": "miyamoto_nagai", "mass": 1.2306e9, "a": 6.0, "b": 0.09},
        "halo": {"kind": "nfw", "mass": 8.08046e11, "rs": 19.6},
    },
)
# gala's MilkyWayPotential, version 1.
GALA_V1 = Preset(
    "gala_v1",
    "MilkyWayPotential of gala: Price-Whelan 2017, JOSS 2, 388; its disc from Bovy 2015, ApJS 216, 29",
    {
        "bulge": {"kind": "hernquist", "mass": 5.0e9, "a": 1.0},
        "nucleus": {"kind": "hernquist", "mass": 1.71e9, "a": 0.07},
        "disc": {"kind": "miyamoto_nagai", "mass": 6.8e10, "a": 3.0, "b": 0.28},
        "halo": {"kind": "nfw", "mass": 5.4e11, "rs": 15.62},
    },
)
# gala's MilkyWayPotential, version 2, once called MilkyWayPotential2022.
GALA_V2 = Preset(
    "gala_v2",
    "MilkyWayPotential2022 of gala: Price-Whelan 2017, JOSS 2, 388; Darragh-Ford et al. 2023, ApJ 955, 74; "
    "Eilers et al. 2019, ApJ 871, 120",
    {
        "bulge": {"kind": "hernquist", "mass": 5.0e9, "a": 1.0},
        "nucleus": {"kind": "hernquist", "mass": 1.8142e9, "a": 0.0688867},
        "disc": {"kind": "sech2_disc", "mass": 4.7717e10, "rd": 2.6, "height": 0.3},
        "halo": {"kind": "nfw", "mass": 5.5427e11, "rs": 15.626},
    },
)
