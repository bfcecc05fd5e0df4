"""Pages on sessions, and the comparison of sessions."""
