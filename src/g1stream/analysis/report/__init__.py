"""The report of sessions: one HTML page that needs no network."""
