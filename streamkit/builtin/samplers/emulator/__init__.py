"""The built-in sampler `emulator`: it learns the predictions from few calls, and samples the data's own likelihood.

`problem` says what the emulator needs of a posterior; `of_target` is that of a run. `start` makes waves of calls with
few particles, from the whole prior to where the data may be. `rounds` makes calls with all particles there until the
emulated posterior has settled. `certificate` compares fresh calls with the emulator. `learn` makes an `emulator` of all
`calls` so far, by a `polynomial` or, where that predicts better, a Gaussian process (`kernel`). `emulated` samples it
(`walk`).
"""
