# %% [markdown]
# # My own potential
#
# A potential is a class with fields and one function, its acceleration. numba compiles it, so it is as fast as a
# built-in one. `plugins/README.md` is the manual, and `streamkit new potential NAME` writes a package.

# %%
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

import streamkit as sk

# %% [markdown]
# The fields have types with units; the run file may give each a number, a quantity or a prior. This one is the
# isochrone of Henon 1959: Phi = -G M / (b + sqrt(b^2 + r^2)). `pull` returns a_r / r of a sphere as a function of r^2.


# %%
class Isochrone(sk.Spherical):
    """Isochrone sphere of Henon (1959)."""

    kind = "my_isochrone"
    reference = "Henon 1959, AnAp 22, 126"
    example = {"mass": 1e12, "b": 10.0}
    mass: sk.Mass = Field(description="Total mass.")
    b: sk.Length = Field(description="Scale radius.")

    @staticmethod
    def pull(r2, mass, b):
        a = sk.sqrt(b * b + r2)
        return -sk.G * mass / ((b + a) * (b + a) * a)

    @staticmethod
    def well(r2, mass, b):
        return -sk.G * mass / (b + sk.sqrt(b * b + r2))


# %% [markdown]
# Compare it with the closed form: v_c^2 = G M r^2 / ((b + a)^2 a) with a = sqrt(b^2 + r^2).

# %%
host = sk.Host({"potential": Isochrone(mass=1e12, b=10.0)})
r = np.array([5.0, 20.0, 100.0])
a = np.sqrt(100 + r**2)
expected = np.sqrt(sk.G * 1e12 * r**2 / ((10 + a) ** 2 * a))
print("v_c by the closed form:", np.round(expected, 6), "and by the class:", np.round(host.circular_velocity(r), 6))
print("v_esc:", np.round(np.sqrt(2 * sk.G * 1e12 / (10 + a)), 6), "and", np.round(host.escape_speed(r), 6))

fine = np.geomspace(1, 200, 200)
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.plot(fine, host.circular_velocity(fine), label="the class")
axes.plot(r, expected, "o", label="the closed form")
axes.set(xlabel="r [kpc]", ylabel="v_c [km/s]", xscale="log")
axes.legend()
figure.savefig("isochrone.png")

# %% [markdown]
# ![The circular velocity of the isochrone](isochrone.png)
#
# The conformance kit tests what every potential must do: that machine code and NumPy agree, the force is curl-free, the
# density is not negative, units scale. It takes half a minute: `from streamkit.testing import check; check(Isochrone)`.
#
# Then use it, here in a notebook by the class itself. From a run file: `plugins = ["./my_isochrone.py"]`, with a
# function `streamkit_components` that returns `[Isochrone]`.

# %%
spec = sk.load(
    {
        "version": 1,
        "potential": {"kind": "my_isochrone", "mass": {"log_uniform": ["3e11 Msun", "3e12 Msun"]}, "b": "10 kpc"},
        "progenitor": {
            "kind": "plummer", "mass": "1e8 Msun", "radius": "0.5 kpc", "x": 40, "y": 0, "z": 0,
            "vx": 0, "vy": 120, "vz": 60, "lookback": "2 Gyr",
        },
        "stripping": {"kind": "mlcs", "particles": 1000},
    },
    components=[Isochrone],
)  # fmt: skip
print(spec.names)
stream = sk.Model(spec).stream({"potential.mass": 1e12})
print(stream, f"of {stream.r.min():.0f} to {stream.r.max():.0f} kpc")
