"""From emulators to samples of their posterior.

`density` is the posterior of all streams by their emulators. `populations` sample it by `moves`, until they agree.
"""
