"""Filter the frames of a sequence in several processes or on several machines, by way of Dask.

A frame is filtered by one worker, by the code that a single process runs. A frame counts as done when its file is whole
on disk, whatever the scheduler remembers. Import `lobewise.farm.running` to use it; only `lobewise.farm.connection`
imports Dask.
"""
