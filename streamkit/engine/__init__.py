"""The compiled part. What an integrator author may use: `Field`, `build_field`, `split_step`, `PEFRL`, `LEAPFROG`."""

from streamkit.engine.field import LEAPFROG, PEFRL, Field, Splitting, build_field, split_step

__all__ = ["LEAPFROG", "PEFRL", "Field", "Splitting", "build_field", "split_step"]
