"""A live view of the session, for Foxglove and Lichtblick."""
