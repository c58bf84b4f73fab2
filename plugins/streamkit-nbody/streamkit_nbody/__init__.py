"""A live satellite disrupted in any host potential of streamkit.

A sphere of particles in equilibrium (`sphere`), its gravity by a sum over pairs or by the tree of pytreegrav
(`gravity`), the host's by streamkit's engine, a leapfrog (`simulation`), snapshots and checkpoints in the Gadget layout
(`snapshot`, `runner`).
"""
