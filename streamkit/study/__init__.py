"""Six studies of a run file: fit, preflight, ablation, sensitivity, and two that run fits: calibration, families."""
