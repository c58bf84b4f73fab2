# %% [markdown]
# # From gala, galpy, AGAMA
#
# What you have in another package: its potentials, its frames, its streams. streamkit takes the potentials of all three
# by their own names, with priors on their own parameters, when the plugin is installed:
# `pip install ./plugins/streamkit-gala`, `streamkit-galpy`, `streamkit-agama`.

# %%
import matplotlib.pyplot as plt
import numpy as np
from astropy import units as u
from gala import potential as gp
from galpy.potential import LogarithmicHaloPotential, vcirc

import streamkit as sk

# %% [markdown]
# ## A potential of gala
#
# In gala: `MilkyWayPotential(version="v2")`. In a run file: `kind = "gala"` and `name`. The parameters are gala's;
# those of a composite have the name of the part before them (`halo_m`). `streamkit plugins potential gala` has the
# manual.

# %%
run = {
    "version": 1,
    "potential": {"kind": "gala", "name": "MilkyWayPotential", "version": "v2"},
    "progenitor": {
        "kind": "plummer", "mass": "2e4 Msun", "radius": "10 pc", "x": -12, "y": 3, "z": 9, "vx": 60, "vy": -200,
        "vz": 40, "lookback": "1 Gyr",
    },
    "stripping": {"kind": "mlcs", "particles": 500},
}  # fmt: skip
r = np.array([8.0, 20.0, 100.0])
places = np.array([r, 0 * r, 0 * r])
theirs = gp.MilkyWayPotential(version="v2")
host = sk.Host.at(run)
print("v_c of gala:     ", theirs.circular_velocity(places * u.kpc).to_value("km/s").round(3))
print("v_c of streamkit:", host.circular_velocity(r).round(3))

# %% [markdown]
# The mass is not the same number, and that is a matter of definition. `Host.mass_inside` is Gauss's law with the mean
# force over the sphere. gala's `mass_enclosed` takes the force along one direction: r^2 |dPhi/dr| / G. They agree for
# a sphere and differ where the disc matters.

# %%
print("M of gala over M of streamkit:", (theirs.mass_enclosed(places * u.kpc).value / host.mass_inside(r)).round(3))

# %% [markdown]
# A stream is made with an expansion of the potential, nearly as fast as with a built-in one:

# %%
stream = sk.Model(run).stream()
print(stream)
x, y, z = stream.q
figure, axes = plt.subplots(figsize=(4, 4), layout="constrained")
axes.plot(x, z, ".", markersize=3)
axes.set(xlabel="x [kpc]", ylabel="z [kpc]", aspect="equal")
figure.savefig("stream.png")

# %% [markdown]
# ![A stream in the potential of gala](stream.png)

# %% [markdown]
# ## A potential of galpy
#
# galpy's numbers are in its natural units, `ro` and `vo`; a run file has physical ones.

# %%
flat = {"kind": "galpy", "name": "LogarithmicHaloPotential", "amp": "48400 km2/s2", "q": 0.9}
galpy = LogarithmicHaloPotential(amp=220**2 * u.km**2 / u.s**2, q=0.9, ro=8.0, vo=220.0)
print("v_c of galpy:    ", [round(float(vcirc(galpy, R * u.kpc)), 3) for R in r])
print("v_c of streamkit:", sk.Host.at(run | {"potential": flat}).circular_velocity(r).round(3))

# %% [markdown]
# ## Frames
#
# A frame of gala is a name here, with gala's spelling. Any great circle is a pole and an origin, or two ends. The frame
# works in astropy beside gala's.

# %%
frame = sk.sky_frame("GD1Koposov10")
seen = frame.from_icrs(153.9, 42.2, -6.0, -10.6)
print(", ".join(f"{name} = {value:.3f}" for name, value in seen._asdict().items()))
print(frame.to_toml())

# %% [markdown]
# ## The words
#
# | gala, galpy, AGAMA | here |
# |---|---|
# | gala `FardalStreamDF`, `ChenStreamDF` | `[stripping] kind = "fardal15_gala"`, `"chen25"` (streamkit-spray) |
# | galpy `streamspraydf` | `[stripping] kind = "fardal15"` or `"chen25"` |
# | `mass_enclosed`, `rvir` | `streamkit host`, `Host.mass_inside` (see above) |
# | `EvolvingPotential`, moving potentials | `[body.NAME]`, `growth` |
# | `stream.to_coord_frame(GD1Koposov10)` | `stream.seen("GD1Koposov10")`, `stream.sky(...)` |
# | AGAMA `Potential(type=...)` | `kind = "agama"` (streamkit-agama), or `multipole` from its tables |
