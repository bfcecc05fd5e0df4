"""HTML reports of sessions, and comparisons of sessions."""
