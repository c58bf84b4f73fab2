# %% [markdown]
# # My stream, my data, in an hour
#
# From a table of member stars to the mass of the Galaxy: the great circle of the stream, a run file, a check, a look, a
# fit, and whether to believe it. The stars are 29 members of GD-1 with positions and proper motions of Gaia and
# velocities of the MMT (Bonaca et al. 2020, ApJL 892, L37). Replace `gd1_members.ecsv` by your table.
#
# The numbers of particles and calls are small, so that the script ends in a minute or two. `FULL=1` in the environment
# takes those of a fit, which needs some minutes more.

# %%
import os
import subprocess
from pathlib import Path

import numpy as np
from astropy.table import QTable

import streamkit as sk

FULL = bool(os.environ.get("FULL"))
particles, calls = (8000, 8000) if FULL else (300, 60)

# %% [markdown]
# ## The stars, and the great circle through them

# %%
stars = QTable.read("gd1_members.ecsv")
frame = sk.sky_frame(stars=(stars["ra"], stars["dec"]))
seen = frame.from_icrs(stars["ra"], stars["dec"], stars["pmra"], stars["pmdec"])
print(frame)
print(f"{len(stars)} stars at phi1 = {seen.phi1.min():.1f} to {seen.phi1.max():.1f} deg")
print(f"phi2 scatters by {seen.phi2.std():.2f} deg")

# %% [markdown]
# The pole is 0.2 deg from that of Koposov, Rix & Hogg 2010. `frame.to_astropy()` is the same frame for astropy, and
# `sk.sky_frame("GD1Koposov10")` is the published one. Published tables are turned from one frame into another through
# ICRS. These are their distances:

# %%
published = sk.sky_frame("GD1Koposov10")
phi1_published = np.array([-55.0, -45.0, -35.0, -25.0, -15.0])
distance, error = [7.2, 7.59, 7.83, 8.69, 8.91], [0.3, 0.4, 0.3, 0.4, 0.4]
ra, dec, *_ = published.to_icrs(phi1_published, np.zeros(5))
distance_phi1 = frame.from_icrs(ra, dec).phi1

# %% [markdown]
# ## The run file
#
# `streamkit init --own` writes a template with comments. This one is made of it. The stars go in as they are: their
# proper motions and the errors of these are turned into the frame by streamkit. The progenitor is not known; it is put
# amid the stars, and five of its coordinates are free, within priors as wide as the data.

# %%
middle = {name: float(np.median(getattr(seen, name))) for name in ("pm_phi1_cosphi2", "pm_phi2")}
velocity = float(np.median(stars["radial_velocity"].value))
run_file = f"""
version = 1
seed = 1

[sun]
r0 = "8.122 kpc"
z = "20.8 pc"
v_circ = "233.4 km/s"            # with v: 245.6 km/s, the proper motion of Sgr A* at this distance
u = 12.9
v = 12.2
w = 7.78

[potential]
kind = "logarithmic_halo"
v0 = {{ uniform = ["150 km/s", "300 km/s"] }}
q = 0.95

[progenitor]
kind = "plummer"
mass = "2e4 Msun"
radius = "30 pc"
{frame.to_toml()}
phi1 = 0
phi2 = {{ uniform = ["-1 deg", "1 deg"] }}
distance = {{ uniform = ["6.5 kpc", "10 kpc"] }}
pm_phi1_cosphi2 = {{ uniform = [{middle["pm_phi1_cosphi2"] - 2:.2f}, {middle["pm_phi1_cosphi2"] + 2:.2f}] }}
pm_phi2 = {{ uniform = [{middle["pm_phi2"] - 2:.2f}, {middle["pm_phi2"] + 2:.2f}] }}
v_los = {{ uniform = [{velocity - 60:.0f}, {velocity + 60:.0f}] }}
lookback = "3 Gyr"

[stripping]
kind = "mlcs"
particles = {particles}
sigma = "1 km/s"

[observable]
kind = "track"
{frame.to_toml()}
kernel = "3 deg"
phi2_dispersion = {{ uniform = ["0 deg", "1 deg"] }}
radial_velocity_dispersion = {{ uniform = ["0 km/s", "20 km/s"] }}
distance = {{ phi1 = {np.round(distance_phi1, 2).tolist()}, distance = {distance}, error = {error} }}
[observable.members]
file = "gd1_members.ecsv"
[observable.members.columns]     # the names that the table has
pm_ra_cosdec = "pmra"
pm_ra_cosdec_error = "pmra_error"
pm_dec = "pmdec"
pm_dec_error = "pmdec_error"

[sampler]
kind = "emulator"
max_calls = {calls}
start_particles = {min(particles, 1000)}
"""
Path("gd1.toml").write_text(run_file)

# %% [markdown]
# ## Check, and look
#
# `streamkit check` reads the run file, counts what a fit will cost, and warns of what makes a fit fail. An error names
# the field, what was found and what is allowed.

# %%
print(subprocess.run(["streamkit", "check", "gd1.toml"], check=True, capture_output=True, text=True).stdout)

# %% [markdown]
# Then one stream, at the middle of the priors or where you want it. Look at it before any fit: does the debris reach
# the stars? `stream.track(frame)` is its mean with the spread and covariance of the debris, as a table or as a picture.

# %%
model = sk.Model("gd1.toml")
stream = model.stream({"potential.v0": 225})
track = stream.track(frame, [-8.0, 0.0, 6.0], kernel=3)
table = track.table()
table.round(3)
print(table["phi1", "phi2", "phi2_spread", "distance", "radial_velocity"])
picture = sk.draw_track(stream.track(frame, kernel=3), stream, frame)
picture.savefig("track.png")

# %% [markdown]
# ![The mean track of the debris, and its spread](track.png)
#
# ## Fit
#
# In a terminal this is `streamkit run gd1.toml -o gd1 --workers 2`. Ctrl-C loses no finished call, `--resume`
# continues. `gd1/report.html` is the page to open. The sampler `emulator` learns how the predictions depend on the
# parameters, and needs about a thousand calls here. A chain of emcee, `--sampler emcee`, is the slow check of it.

# %%
results = sk.run("gd1.toml", out="gd1", workers=2 if FULL else 1)
print(results.summary()["parameter", "median", "lo68", "hi68", "unit"])
print(results.mass_profile([10, 20]))

# %% [markdown]
# ![The stream of the best sample, beside the data](gd1/best_stream.png)
#
# ## Is it right?
#
# First the sampler: fresh calls at samples of the posterior either confirm the emulator or not. Every table and picture
# says so. Without `FULL` they do not: do not quote these numbers.

# %%
print(results.note())
print("converged:", results.converged)

# %% [markdown]
# Then the model, which no sampler can judge. With `FULL` the mass inside 20 kpc is about 2.3 x 10^11 Msun. Malhan &
# Ibata 2019 (MNRAS 486, 2995) have 2.5 ± 0.2 from more stars of the stream. With `v_circ = "host"`, which moves the Sun
# with the fitted host, the same data give 3.3: a logarithmic halo is no model of the Galaxy near the Sun.
#
# These questions have a page or a tutorial each:
#
# - Do the data lie where the model says? `predictions.png` has every datum beside its prediction.
# - Which parameters do the data weigh? `streamkit sensitivity gd1.toml`; `priors.png` shows what is still the prior.
# - Does the fit find a mass that is known? `streamkit calibrate`: the tutorial *Is my mass right*.
# - Would another stripping scheme move the mass? `streamkit ablate gd1.toml --vary stripping.kind=mlcs,streakline`.
# - Does the Large Magellanic Cloud matter? The tutorial *Add the LMC*.
#
# Two things are left out here: the fraction of stars that are no members (`radial_velocity_outliers` and the like), and
# other data on the host: a rotation curve belongs to `[data.rotation_curve]`.
