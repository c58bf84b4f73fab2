"""Simulations as hosts: the particles of snapshots become the table of a `multipole` potential that changes in time.

A snapshot is read (`snapshot`), its particles are summed to multipoles (`multipoles`), and a series of them makes a
table (`series`). Hosts that EXP (`exp`) and AGAMA (`agama`) have expanded are read without these codes. `cylspline` is
a host on a grid in R and z.
"""

from streamkit_hosts.series import Series as Series
from streamkit_hosts.series import expand as expand
