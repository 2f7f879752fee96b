"""Files made at random, of every kind that lobewise reads: each is read or refused, whatever it holds.

``readers`` says what reading a kind of file is, ``strategies`` and ``exr_files`` make files, ``watch`` reads them in a
process of its own that may crash, hang or run out of memory, ``corpus`` writes the seeds, ``run`` fuzzes for minutes.
CONTRIBUTING.md says how to use them.
"""
