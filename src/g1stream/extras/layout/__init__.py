"""Layouts of viewers for sessions."""
