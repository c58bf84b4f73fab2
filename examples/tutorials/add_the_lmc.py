# %% [markdown]
# # Add the LMC
#
# The Large Magellanic Cloud pulls at streams beyond some 15 kpc, and moves the Galaxy itself. A section `[body.lmc]`
# brings both. Here the Orphan stream's model is made with and without the LMC. On a new machine the first streams take
# a minute or two: streamkit compiles their equations, once, and says nothing in Python meanwhile.

# %%
import matplotlib.pyplot as plt
import numpy as np

import streamkit as sk

run = {
    "version": 1,
    "seed": 1,
    "potential": {
        "disc": {"kind": "miyamoto_nagai", "mass": "6.8e10 Msun", "a": "3 kpc", "b": "0.28 kpc"},
        "bulge": {"kind": "hernquist", "mass": "5e9 Msun", "a": "1 kpc"},
        "halo": {"kind": "nfw", "mass": "8e11 Msun", "rs": "15.6 kpc"},
    },
    "progenitor": {
        "kind": "plummer", "mass": "1e6 Msun", "radius": "0.2 kpc", "frame": "OrphanKoposov19",
        "phi1": "6.3 deg", "phi2": "-0.5 deg", "distance": "18.8 kpc",
        "pm_phi1_cosphi2": "3.6 mas/yr", "pm_phi2": "2.6 mas/yr", "v_los": "95 km/s", "lookback": "3 Gyr",
    },
    "stripping": {"kind": "mlcs", "particles": 2000, "sigma": "2 km/s"},
}  # fmt: skip

# %% [markdown]
# The body has a potential of its own, of any kind with a mass, and a place today. It is subject to dynamical friction
# and moves the Galaxy unless `friction = "none"` or `reflex = false` is given. The place is that of Kallivayalil et al.
# 2013 and Pietrzynski et al. 2019, the mass that of Erkal et al. 2019. A prior would make the mass a parameter of the
# fit: `mass = { log_uniform = ["2e10 Msun", "3e11 Msun"] }`.

# %%
lmc = {
    "kind": "hernquist", "mass": "1.4e11 Msun", "a": "15 kpc", "ra": "78.76 deg", "dec": "-69.19 deg",
    "distance": "49.6 kpc", "pm_ra_cosdec": "1.91 mas/yr", "pm_dec": "0.229 mas/yr", "v_los": "262.2 km/s",
}  # fmt: skip
frame = sk.sky_frame("OrphanKoposov19")
grid = np.arange(-30.0, 90.0, 2.0)
alone = sk.Model(run).stream().track(frame, grid, kernel=4)
beside = sk.Model(run | {"body": {"lmc": lmc}}).stream().track(frame, grid, kernel=4)
for name, unit in (("phi2", "deg"), ("pm_phi2", "mas/yr"), ("radial_velocity", "km/s")):
    print(name, f"[{unit}], with the LMC less without:", np.round(beside[name] - alone[name], 2)[::10])

figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.plot(grid, alone["phi2"], label="without the LMC")
axes.plot(grid, beside["phi2"], label="with the LMC")
axes.set(xlabel="phi1 [deg]", ylabel="phi2 [deg]")
axes.legend()
figure.savefig("orphan.png")

# %% [markdown]
# ![The mean track of the Orphan stream with and without the LMC](orphan.png)
#
# `streamkit host RUN.toml` prints the orbits of the bodies, their pericentres and tidal radii. From Python:

# %%
host = sk.Host.at(run | {"body": {"lmc": lmc}})
orbit = host.orbits(lookback=3.0)["lmc"]
print(f"The LMC is at {orbit.r[-1]:.1f} kpc today and was at {orbit.r[0]:.0f} kpc 3 Gyr ago.")

# %% [markdown]
# - The host that is printed, and `M(<r)`, are those of the Galaxy alone, today, without its bodies.
# - Energies of the debris are not conserved beside a moving body.
# - A fit costs about twice as much per stream. Nothing else in the run file changes. `examples/orphan_lmc` is such a
#   fit with data, and `examples/lmc` recovers a mock.
