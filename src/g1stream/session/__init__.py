"""Session files: the MCAP format, and how they are written and read."""
