"""Potentials of hosts, progenitors and other bodies, and published Milky Ways."""
