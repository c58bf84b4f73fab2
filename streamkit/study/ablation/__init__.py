"""The ablation: variants of a run file compared with each other and with an N-body snapshot."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
