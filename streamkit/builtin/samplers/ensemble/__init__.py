"""The default sampler `emcee`: an ensemble of walkers, and the surrogate of the posterior that its moves learn."""
