"""Session files: the MCAP format, its writer and its readers."""
