"""What a field of a component may hold besides a number: an array, a table, a file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
