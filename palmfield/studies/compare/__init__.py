"""Compare a measured scan with a run.

from palmfield.studies.compare.run import compare
print(compare("out/palm", "scan.csv"))
"""
