"""Motion capture files: their readers, their skeletons, and the way onto ours."""
