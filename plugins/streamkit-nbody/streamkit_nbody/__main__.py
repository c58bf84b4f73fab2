"""`python -m streamkit_nbody`: the same as `streamkit nbody`."""

from streamkit_nbody.cli import main

if __name__ == "__main__":
    main()
