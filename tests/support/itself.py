"""A run file whose posterior is known: its only parameter is measured directly, and prior and error are Gaussian."""

from pathlib import Path

import numpy as np
from runfiles import changed
from scipy.stats import norm

import streamkit as sk

PLUGIN = '''
import numpy as np
from streamkit import Observable, Prediction, Velocity, VelocityDatum, hookimpl

class Itself(Observable):
    """The parameter v0 of the host, measured directly: its posterior is known."""

    kind = "itself"
    example = {"speed": [200.0, 20.0]}
    speed: VelocityDatum
    bias: Velocity = 0.0

    def predict(self, stream):
        return Prediction(("speed",), np.array([stream.parameters["potential.v0"] + self.bias]), np.zeros(1))

    def data(self):
        return np.array([self.speed[0]]), np.array([self.speed[1]])

    def mock(self, prediction, rng):
        return {"speed": [float(rng.normal(prediction.mean[0], self.speed[1])), self.speed[1]]}

@hookimpl
def streamkit_components():
    return [Itself]
'''
MEAN, SD, ERROR = 200.0, 20.0, 20.0
WIDTH = SD / np.sqrt(2)  # of the posterior, whose mean is halfway between the prior's and the datum


def itself(folder: Path) -> sk.Spec:
    """Return the run file; its plugin is written into a folder."""
    plugin = folder / "itself.py"
    plugin.write_text(PLUGIN)
    document = changed("plugins", [str(plugin)])
    document["potential"] |= {"v0": {"normal": [MEAN, SD]}}
    document["progenitor"] |= {"mass": 5e8, "lookback": 0.2}
    document["stripping"] |= {"particles": 2, "sigma": 10.0}
    document["observable"] = {"kind": "itself", "speed": [MEAN, ERROR]}
    document["sampler"] = {"moves": "stretch", "steps": 250, "walkers": 8, "tau_factor": 10.0, "r_hat": 1.5}
    return sk.load(document)


def exact_rank(truth: float, datum: float) -> float:
    """Return the share of the posterior below the truth."""
    return float(norm.cdf((truth - 0.5 * (datum + MEAN)) / WIDTH))
