from .as_stream import as_stream as as_stream
from .read import read_snapshot as read_snapshot
