from .expand import Expanded as Expanded
from .expand import Form as Form
from .expand import NoExpansion as NoExpansion
from .expand import expand as expand
from .expand import expand_like as expand_like
from .forces import Expansion as Expansion
from .forces import expansion_of as expansion_of
from .grid import Grid as Grid
