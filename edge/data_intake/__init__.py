"""A stranger's log becomes run files: what it means is guessed, written down as a mapping, then applied.

Delimiters, times, units and names of foreign CSV and XLSX files. The run file itself is read and written by
`edge.formats.run_file`.
"""
