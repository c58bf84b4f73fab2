"""The built-in sampler `emulator`: it learns the predictions from few calls, and samples the data's own likelihood.

`rounds` is the algorithm, to be read first. `start` comes from the whole prior to where the data may be, and `known` is
what is known of a stream then. `places` says where a stream is called, and `tilt` what the others say of it. Its
`certificate` compares it with fresh calls; `changes` compares posteriors. Three folders stand below: `learn` makes an
emulator of calls, `walk` samples the posterior of all emulators, and `judge` says what is missing.
"""
