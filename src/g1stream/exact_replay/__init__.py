"""Recorded commands, sent again bit for bit."""
