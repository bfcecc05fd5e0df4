"""Motion files of other programs: read by what is in them, and written for training."""
