"""From DDS into a session file."""
