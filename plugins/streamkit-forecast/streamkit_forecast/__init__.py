"""Forecasts: what data, or data that do not exist yet, tell about a host.

The predictions of a run file are taken to be linear in the parameters about one place, and all errors to be Gaussian.
The slopes come from streams with common random numbers (`slopes`), data that do not exist yet are observables beside
those of the run file (`surveys`), and the Cramer-Rao bounds follow from both and from the priors (`information`).
"""

from streamkit_forecast.runner import Forecast as Forecast
from streamkit_forecast.runner import forecast as forecast
