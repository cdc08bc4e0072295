"""Motion capture of cameras as they deliver: the counterpart of ``offline``."""
