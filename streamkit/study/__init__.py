"""Five studies of a run file: fit, preflight, ablation, sensitivity, and calibration, which runs fits."""
