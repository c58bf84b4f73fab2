"""Training sets for inference by simulations: streams and their observables for many draws of the priors.

A draw is a function of the run file and of its number alone (`simulator`), so that any process may make it. All
draws lie in one HDF5 file of fixed size (`archive`), which an interrupted command continues (`runner`).
"""

from streamkit_simulate.runner import Simulated as Simulated
from streamkit_simulate.runner import simulate as simulate
