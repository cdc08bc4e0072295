"""Readers of user files. They check sizes and shapes in headers against limits before they unpack anything, and raise
an ``InputError`` of one line for a file that cannot be read."""
