"""Poses as files: CSV, OpenSim's TRC, and BVH animations."""

from depthmocap.exporting.bvh import read_bvh, write_bvh
from depthmocap.exporting.pose_csv import CsvWriter, write_csv
from depthmocap.exporting.trc import read_trc, write_trc
from depthmocap.recordings.pose_table import read_csv

__all__ = ["CsvWriter", "read_bvh", "read_csv", "read_trc", "write_bvh", "write_csv", "write_trc"]
