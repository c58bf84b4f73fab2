"""From calls to an emulator of their predictions.

`problem` says what is needed of a posterior, and `of_target` is that of a run. `calls` holds what was called, and
`pairs` measures its noise. `from_calls` chooses a `polynomial`, or a Gaussian process where that predicts better
(`kernel`).
"""
