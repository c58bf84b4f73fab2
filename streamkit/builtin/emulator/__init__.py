"""The built-in sampler `emulator`: it learns the predictions from few calls, and samples the data's own likelihood.

`problem` is all that it needs to know of a posterior. `start` makes waves of calls with few particles, from the whole
prior to where the data may be; `rounds` makes calls with all particles there until the emulated posterior has settled;
`certificate` compares fresh calls with the emulator. In between, `learn` makes an `emulator` of all calls so far, by a
`polynomial` or, where that predicts better, a Gaussian process (`kernel`), and `emulated` samples it (`walk`).
"""
