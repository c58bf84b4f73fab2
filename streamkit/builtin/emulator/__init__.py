"""The built-in sampler `emulator`: it learns the predictions from few calls, and samples the data's own likelihood."""
