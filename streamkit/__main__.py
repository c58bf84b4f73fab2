"""``python -m streamkit``: the same as the command ``streamkit``."""

from streamkit.cli.main import main

main()
