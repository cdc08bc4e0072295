"""Poses as files: CSV, OpenSim's TRC, and BVH animations."""

from depthmocap.export.bvh import read_bvh, write_bvh
from depthmocap.export.csv import CsvWriter, read_csv, write_csv
from depthmocap.export.trc import read_trc, write_trc

__all__ = ["CsvWriter", "read_bvh", "read_csv", "read_trc", "write_bvh", "write_csv", "write_trc"]
