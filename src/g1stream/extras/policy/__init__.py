"""Learned policies: what one takes and gives, and its commands."""
