"""The compiled part: what an integrator author may use beside the names of `streamkit`.

How the loop goes through the particles stands at the head of `streamkit.engine.loops`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
