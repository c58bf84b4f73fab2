"""`python -m streamkit_nbody`."""

from streamkit_nbody.cli import main

main()
