"""Expansions of forces, spherical, axisymmetric or general: what cannot be compiled at compiled speed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
