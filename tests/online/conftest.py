"""Threads of cameras are tested in virtual time."""

from virtual_time import virtual

__all__ = ["virtual"]
