"""Filter the frames of a sequence in several processes of this machine, or on several machines by way of Dask.

A frame is filtered by one worker, by the code that a single process runs. A frame counts as done when its file is whole
on disk, whatever the scheduler remembers. Import `lobewise.farm.running` to use it; `lobewise.farm.processes` and
`lobewise.farm.connection` open the workers, and only the latter imports Dask.
"""
