"""How particles are carried through the host."""
