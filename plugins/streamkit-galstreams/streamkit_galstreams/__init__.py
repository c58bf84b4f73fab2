"""Run files for the streams of galstreams (Mateu 2023, MNRAS 520, 5225).

The tracks are read from the package's files (`catalogue`). What they measured is told from what fills a column
(`measured`). A run file with a table for each stream is written from that (`points`, `progenitor`, `runfile`).
"""
