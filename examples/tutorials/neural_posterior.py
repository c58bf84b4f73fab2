# %% [markdown]
# # A neural posterior on the test bench
#
# `streamkit simulate` (package streamkit-simulate) makes a training set, [sbi](https://github.com/sbi-dev/sbi) learns a
# posterior from it, and `streamkit calibrate` tests that posterior as it tests our own fits. Any other method is tested
# in the same way: a function of the mock data that returns samples.
#
# `pip install 'tidal-streamkit[simulate]' sbi`; sbi brings PyTorch. The numbers are small so that the script ends in
# minutes. `FULL=1` in the environment takes useful ones.

# %%
import os
from pathlib import Path

import h5py
import matplotlib.pyplot as plt
import numpy as np
import torch
from sbi.inference import NPE
from sbi.utils import BoxUniform
from streamkit_simulate import simulate

import streamkit as sk

FULL = bool(os.environ.get("FULL"))
draws, tests = (6000, 60) if FULL else (200, 2)
Path("short.toml").write_text("""
version = 1
[potential]
kind = "tf"
v0 = { uniform = ["160 km/s", "260 km/s"] }
rs = "12 kpc"
alpha = { uniform = [0.25, 0.45] }
[progenitor]
kind = "plummer"
mass = "6.4e8 Msun"
radius = "0.85 kpc"
x = 19.2
y = 0.03
z = -5.7
vx = 176.5
vy = -0.4
vz = 201.6
lookback = "3.7 Gyr"
[stripping]
kind = "mlcs"
particles = 1000
[observable]
kind = "apocentres"
leading = ["57 kpc", "2 kpc"]
trailing = ["96 kpc", "5 kpc"]
precession = ["95 deg", "5 deg"]
[sampler]
kind = "emulator"
""")

# %% [markdown]
# ## The training set, and ten lines of sbi
#
# Draws without a stream have no data. They are regions of the prior with zero likelihood, and are left out.

# %%
spec = sk.load("short.toml")
simulate(spec, "sims.h5", draws=draws, progress=False, force=True)

with h5py.File("sims.h5") as file:
    theta, x, observed = (torch.tensor(file[name][:], dtype=torch.float32) for name in ("theta", "x", "x_observed"))
good = x.isfinite().all(axis=1)
low, high = np.array([prior.support for prior in spec.priors], dtype="f4").T
inference = NPE(BoxUniform(torch.tensor(low), torch.tensor(high)), show_progress_bars=False)
inference.append_simulations(theta[good], x[good]).train(stop_after_epochs=20 if FULL else 2)
posterior = inference.build_posterior()
samples = posterior.sample((2000,), x=observed, show_progress_bars=False).numpy()

# %% [markdown]
# ## Beside the emulator
#
# Means and standard deviations of both, and their difference in standard deviations. With `FULL`, 5571 draws gave v0 =
# 199.9 +- 5.6 km/s and alpha = 0.354 +- 0.044, the emulator 200.1 +- 6.2 and 0.361 +- 0.052: they agree to 0.13 sd.

# %%
fit = sk.run(spec if FULL else spec.with_values({"sampler.max_calls": 200}), progress=False)
for i, name in enumerate(spec.names):
    ours, theirs = fit[name], samples[:, i]
    shift = (theirs.mean() - ours.mean()) / ours.std()
    print(f"{name}: emulator {ours.mean():.4g} +- {ours.std():.2g}, network {theirs.mean():.4g} +- {theirs.std():.2g}, "
          f"shift {shift:+.2f} sd")  # fmt: skip

figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
axes.plot(*samples.T[:2], ".", markersize=2, label="network")
axes.plot(fit[spec.names[0]], fit[spec.names[1]], ".", markersize=2, label="emulator")
axes.set(xlabel="v0 [km/s]", ylabel="alpha")
axes.legend(markerscale=4)
figure.savefig("posteriors.png")

# %% [markdown]
# ![The samples of both posteriors](posteriors.png)
#
# ## The test bench
#
# Truths are drawn from the prior. The network gets the mock data of each, never the truth, and the rank of the truth
# among its samples must be uniform. The mock data have the order of `x` in the training set. With `FULL`, its 68 %
# intervals held 70 % and 65 % of 60 truths (68 +- 6 % are right), and the mean ranks were 0.48 (0.50 +- 0.04).


# %%
def network(mock: sk.Mock) -> np.ndarray:
    """Return samples of the posterior of mock data."""
    data = torch.tensor(mock.values, dtype=torch.float32)
    return posterior.sample((500,), x=data, show_progress_bars=False).numpy()


tested = sk.calibrate(spec, "network-calibration", draws=tests, method=network)
print("share of truths in the 68 % intervals:", dict(zip(spec.names, tested.coverage(0.68).tolist(), strict=False)))
print("mean rank, 0.5 without a bias:", dict(zip(spec.names, tested.ranks.mean(axis=0).tolist(), strict=False)))

# %% [markdown]
# A method in another language needs no Python. `streamkit calibrate short.toml --draws 100 --write-mocks mocks` writes
# the mock data as files, and `streamkit calibrate short.toml --samples mocks` reads the samples that it left beside
# them, and writes the tables and the picture of the ranks.
