"""What is missing before a posterior may be tested or given.

`together` tests all streams, by fresh calls or by those that were `held_out`. `settled` measures what the noise of all
calls leaves uncertain; `recall`, `remembered` and `reach` look for parts that the emulators have given up.
"""
