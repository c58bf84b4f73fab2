"""Ways to the posterior: `emcee`, the default, and `emulator`."""
