"""``python -m streamkit``: the same as the command ``streamkit``."""

from streamkit.cli.main import main

if __name__ == "__main__":  # Dask's workers and the ranks of MPI import this module under other names
    main()
