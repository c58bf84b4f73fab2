"""The compiled code. Authors of integrators may use these names beside those of `streamkit`.

`streamkit.engine.loops` explains at its head how a loop goes through the particles.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
