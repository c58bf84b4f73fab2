"""The built-in sampler `emulator`: it learns the predictions from few calls, and samples the data's own likelihood.

`rounds` is the algorithm, to be read first. It stands on three kinds of files. What can be called: `problem` says what
the emulator needs of a posterior, `of_target` is that of a run; `calls` holds what was called, `pairs` measures noise.
What is learned: `learn` makes an `emulator` of all calls, by a `polynomial` or, where that predicts better, a Gaussian
process (`kernel`). What is sampled: `density` is the posterior of all factors by their emulators, in coordinates of
`space`; `populations` sample it by `moves`, one of which is by a `mixture`. `start` comes from the whole prior to where
the data may be; `certificate` and `recall` test the end; `changes` compares posteriors.
"""
